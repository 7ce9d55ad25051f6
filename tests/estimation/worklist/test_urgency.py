"""How urgent a wheelset is: what is not known is never taken for good, and the words say the numbers."""

from __future__ import annotations

from dataclasses import replace

import pytest
from believed_now import limit_of

from estimation.trend.now import SCALE
from estimation.values.alerts import Condition, LimitNow, OpenAlert, Severity, Urgency
from estimation.values.quantities import Estimate, Forecast, with_interval
from estimation.values.reasons import Reason, ReasonCode
from estimation.worklist.row import MEASURE, TURN, judged, rounded_km

CONICITY = with_interval(0.3, 0.01)
# either side of 0.8 of the limit of 0.4
FAR_BELOW, NOT_FAR_BELOW = (replace(CONICITY, high=high) for high in (0.3199, 0.3201))
OPEN = Reason(ReasonCode.CONICITY_OPEN, "the data leave it open")
FEW = Reason(ReasonCode.TOO_FEW_POINTS, "2 points")
LAST_NS = 1_767_398_400_000_000_000  # 2026-01-03


UNKNOWN = limit_of(None, Estimate.unknown(OPEN), reason=OPEN)
BEYOND = limit_of(0.0, CONICITY, reason=Reason(ReasonCode.BEYOND_HORIZON, "beyond"))
DUE_WITHIN_KM = SCALE.due_within_km


def ahead(p10: float | None, p50: float | None = None, over: float = 0.0) -> LimitNow:
    missing = None if p50 is not None else Reason(ReasonCode.BEYOND_HORIZON, "beyond")
    return limit_of(over, CONICITY, distance_km=Forecast(p10, p50, p50), reason=missing)


def alert(kind: str, severity: Severity = Severity.WARNING, condition: Condition = Condition.ACTIVE) -> OpenAlert:
    return OpenAlert(1, kind, severity, condition, 0, acknowledged=False, shelved_until_ns=None)


def verdict(
    of: LimitNow, *alerts: OpenAlert, mounted: bool = True, last_ns: int | None = LAST_NS
) -> tuple[Urgency, tuple[Reason, ...]]:
    return judged(mounted=mounted, now=of, alerts=alerts, last_ns=last_ns)


@pytest.mark.parametrize(
    ("of", "alerts", "urgency", "texts"),
    [
        (ahead(0.0, 0.0, 0.98), [], Urgency.OVER_LIMIT, [f"limit exceeded (probability 98%): {TURN}"]),
        (ahead(0.0, 0.0, 0.9), [], Urgency.OVER_LIMIT, [f"limit exceeded (probability 90%): {TURN}"]),
        (ahead(0.0, 0.0, 0.89), [], Urgency.PROBABLY_OVER, [f"limit probably exceeded (probability 89%): {TURN}"]),
        (ahead(0.0, 0.0, 0.5), [], Urgency.PROBABLY_OVER, [f"limit probably exceeded (probability 50%): {TURN}"]),
        (
            ahead(0.0, 900.0, 0.3),
            [alert("conicity_limit", Severity.CRITICAL)],
            Urgency.DUE,
            [f"the alert on the limit is not cleared yet (probability 30%): {MEASURE}"],
        ),
        (
            ahead(2e5, 3e5, 0.02),
            [alert("conicity_limit", Severity.CRITICAL)],
            Urgency.WATCH,
            [f"the alert on the limit is not cleared yet (probability 2%): {MEASURE}"],
        ),
        (
            limit_of(1e-9, CONICITY, reason=FEW),
            [],
            Urgency.FINE,
            ["conicity of at most 0.32, far below the limit of 0.40; 2 points"],
        ),
        (limit_of(1e-9, FAR_BELOW, reason=FEW), [], Urgency.FINE, None),
        (limit_of(1e-9, NOT_FAR_BELOW, reason=FEW), [], Urgency.UNKNOWN, ["2 points"]),
        (limit_of(0.3, CONICITY, reason=FEW, limit=0.31), [], Urgency.UNKNOWN, ["2 points"]),
        (
            limit_of(0.6, CONICITY, reason=FEW, limit=0.29),
            [],
            Urgency.PROBABLY_OVER,
            [f"limit probably exceeded (probability 60%): {TURN}"],
        ),
        (ahead(500.0, 900.0, 0.49), [], Urgency.DUE, ["due in 900 km (p10 500 km)"]),
        (ahead(8_049.0, 12_351.0), [], Urgency.DUE, ["due in 12,400 km (p10 8,050 km)"]),
        (ahead(DUE_WITHIN_KM, 9e4), [], Urgency.DUE, ["due in 90,000 km (p10 30,000 km)"]),
        (ahead(DUE_WITHIN_KM + 1, 9e4), [], Urgency.FINE, ["due in 90,000 km (p10 30,000 km)"]),
        (ahead(2e5), [], Urgency.FINE, ["due beyond the horizon (p10 200,000 km)"]),
        (BEYOND, [], Urgency.FINE, ["beyond"]),
        (UNKNOWN, [], Urgency.UNKNOWN, ["the data leave it open"]),
        (BEYOND, [alert("limit_forecast", Severity.INFO)], Urgency.DUE, ["due beyond the horizon"]),
        (
            UNKNOWN,
            [alert("conicity_limit", Severity.CRITICAL, Condition.UNKNOWN)],
            Urgency.OVER_LIMIT,
            [f"limit exceeded when it could be assessed last: {TURN}", "the data leave it open"],
        ),
        (
            UNKNOWN,
            [alert("conicity_limit")],
            Urgency.PROBABLY_OVER,
            [f"limit probably exceeded when it could be assessed last: {TURN}"],
        ),
        (ahead(0.0, 900.0, 0.2), [], Urgency.DUE, ["due in 900 km, perhaps already (probability 20%)"]),
        (ahead(0.0, 0.0, 0.999), [], Urgency.OVER_LIMIT, [f"limit exceeded (probability 99%): {TURN}"]),
        (ahead(0.0, 0.0, 0.8999), [], Urgency.PROBABLY_OVER, [f"limit probably exceeded (probability 89%): {TURN}"]),
        (
            ahead(0.0, 0.0, 0.7),
            [alert("measure")],
            Urgency.PROBABLY_OVER,
            [f"limit probably exceeded (probability 70%): {TURN}"],
        ),
        (BEYOND, [alert("conicity_limit", condition=Condition.PENDING)], Urgency.FINE, ["beyond"]),
        (BEYOND, [alert("hunting", condition=Condition.CLEARED)], Urgency.FINE, ["beyond"]),
        (
            BEYOND,
            [alert("hunting", Severity.CRITICAL)],
            Urgency.CRITICAL_ALERT,
            ["it hunts: check yaw dampers and wheel profiles", "beyond"],
        ),
        (
            BEYOND,
            [alert("data_quality")],
            Urgency.WATCH,
            ["its mileage or recordings cannot be believed: check odometer and recordings", "beyond"],
        ),
        (BEYOND, [alert("no_data", Severity.CRITICAL)], Urgency.UNKNOWN, ["no data since 2026-01-03", "beyond"]),
        (BEYOND, [alert("sensor_fault")], Urgency.UNKNOWN, ["the sensor is faulty", "beyond"]),
        (
            ahead(500.0, 900.0),
            [alert("no_data")],
            Urgency.DUE,
            ["due in 900 km (p10 500 km)", "no data since 2026-01-03"],
        ),
        (BEYOND, [alert("identity", Severity.INFO)], Urgency.UNKNOWN, None),
    ],
)
def test_the_most_urgent_reason_decides_and_all_are_said(
    of: LimitNow, alerts: list[OpenAlert], urgency: Urgency, texts: list[str] | None
) -> None:
    found, reasons = verdict(of, *alerts)
    assert found is urgency
    assert texts is None or [reason.text for reason in reasons] == texts


def test_no_data_ever_is_said_as_such() -> None:
    _, reasons = verdict(UNKNOWN, alert("no_data"), last_ns=None)
    assert [reason.text for reason in reasons] == ["no data ever", "the data leave it open"]
    _, reasons = judged(mounted=True, now=UNKNOWN, alerts=[alert("no_data")], last_ns=LAST_NS, refused=True)
    assert reasons[0].text == "no usable data since 2026-01-03"


def test_what_is_not_mounted_comes_last_whatever_it_was() -> None:
    found, reasons = verdict(ahead(0.0, 0.0, 0.99), mounted=False)
    assert found is Urgency.NOT_MOUNTED
    assert [reason.code for reason in reasons] == [ReasonCode.NOT_MOUNTED, ReasonCode.LIMIT_EXCEEDED]


def test_the_unknown_come_before_all_that_last() -> None:
    assert [urgency.rank for urgency in Urgency] == [1, 2, 3, 4, 5, 6, 7, 8]
    assert Urgency.UNKNOWN.rank < Urgency.FINE.rank


@pytest.mark.parametrize(
    ("distance_km", "text"), [(0.4, "0"), (949.6, "950"), (12_350.0, "12,400"), (12_250.0, "12,300"), (3e5, "300,000")]
)
def test_distances_have_three_digits_as_on_the_page(distance_km: float, text: str) -> None:
    assert rounded_km(distance_km) == text
