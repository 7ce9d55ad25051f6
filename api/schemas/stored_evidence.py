"""The evidence that alerts keep, as the API answers it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal

from api.schemas import evidence as kinds
from api.schemas.stored_values import Stored, code, count, counted, date, distance, estimate, moment, number, part, text
from estimation.alerts.fleet_alerts import MEMBER_COUNT, OPEN_MEMBER_COUNT, WHEELSETS
from estimation.alerts.life_cycle import DELAYS
from estimation.alerts.rules.identity import MOUNTED
from estimation.values.alerts import Alert, AlertScope
from estimation.values.json_value import JsonValue
from estimation.values.reasons import Reason
from estimation.values.trend import AFTER, BEFORE, StepCause

_INDICATORS: tuple[Literal["offset", "shape"], ...] = ("offset", "shape")
_MOUNTED_PARTS = 4
_CAUSES = tuple(cause.value for cause in StepCause)


def evidence_of(alert: Alert) -> kinds.Evidence:
    """Return the evidence of an alert."""
    if alert.scope is AlertScope.FLEET:
        return _fleet_alert(alert)
    read = _READERS.get(alert.kind, _other)
    return read(alert.evidence)


def _delays(stored: Stored) -> kinds.Delays | None:
    found = part(stored.get(DELAYS))
    if not found:
        return None
    return kinds.Delays(
        on_evaluations=count(found.get("on_evaluations")),
        off_evaluations=count(found.get("off_evaluations")),
        on_delay_km=number(found.get("on_delay_km")) or None,
        off_delay_km=number(found.get("off_delay_km")) or None,
        acknowledgement_days=number(found.get("acknowledgement_days")),
        clear_seen=count(found.get("clear_seen")),
        counted_at=moment(found.get("counted_ns")),
    )


def _of_rule(stored: Stored) -> dict[str, Any]:
    """Return what the evidence of most rules has."""
    because = text(stored.get("unknown_because"))
    return {
        "unknown_because": because,
        "unknown_because_code": code(stored.get("unknown_because_code")),
        "delays": _delays(stored),
    }


def _conicity_limit(stored: Stored) -> kinds.ConicityLimitEvidence:
    return kinds.ConicityLimitEvidence(
        kind="conicity_limit",
        quantity=text(stored.get("quantity")),
        amplitude_mm=number(stored.get("amplitude_mm")),
        conicity_1=estimate(stored.get("conicity")),
        current_1=estimate(stored.get("current")),
        windows=count(stored.get("windows")),
        limit_1=number(stored.get("limit")),
        **_of_rule(stored),
    )


def _measure(stored: Stored) -> kinds.MeasureEvidence:
    return kinds.MeasureEvidence(
        kind="measure",
        quantity=text(stored.get("quantity")),
        conicity_1=estimate(stored.get("conicity")),
        reached_mm=number(stored.get("reached_mm")),
        reached_1=estimate(stored.get("reached")),
        windows=count(stored.get("windows")),
        limit_1=number(stored.get("limit")),
        **_of_rule(stored),
    )


def _limit_forecast(stored: Stored) -> kinds.LimitForecastEvidence:
    of_rule = _of_rule(stored)
    because, because_code = of_rule["unknown_because"], of_rule["unknown_because_code"]
    unknown = None if because is None or because_code is None else Reason(because_code, because)
    return kinds.LimitForecastEvidence(
        kind="limit_forecast",
        quantity=text(stored.get("quantity")),
        slope_1_per_1000_km=estimate(stored.get("slope_per_1000_km")),
        fitted_1=estimate(stored.get("fitted")),
        distance_to_limit_km=distance(stored.get("distance_to_limit_km"), unknown),
        date_of_limit=date(stored.get("date_of_limit_ns"), unknown),
        within_km=number(stored.get("within_km")),
        limit_1=number(stored.get("limit")),
        points=count(stored.get("points")),
        **of_rule,
    )


def _wheel_asymmetry(stored: Stored) -> kinds.WheelAsymmetryEvidence:
    listed = stored.get("raised_by")
    raised_by = listed if isinstance(listed, list) else []
    return kinds.WheelAsymmetryEvidence(
        kind="wheel_asymmetry",
        offset_mm=estimate(stored.get("offset_mm")),
        shape_mm=estimate(stored.get("shape_mm")),
        raised_by=[name for name in _INDICATORS if name in raised_by],
        windows=count(stored.get("windows")),
        **_of_rule(stored),
    )


def _no_data(stored: Stored) -> kinds.NoDataEvidence:
    return kinds.NoDataEvidence(
        kind="no_data",
        last_usable_at=moment(stored.get("last_usable_ns")),
        in_service_since=moment(stored.get("in_service_since_ns")),
        limit_days=number(stored.get("limit_days")),
        refused_windows=count(stored.get("refused_windows")),
        reasons=counted(stored.get("reasons")),
        reason=text(stored.get("reason")),
        delays=_delays(stored),
    )


def _sensor_fault(stored: Stored) -> kinds.SensorFaultEvidence:
    return kinds.SensorFaultEvidence(
        kind="sensor_fault",
        faulty_windows=count(stored.get("faulty_windows")),
        windows=count(stored.get("windows")),
        reasons=counted(stored.get("reasons")),
        **_of_rule(stored),
    )


def _identity(stored: Stored) -> kinds.IdentityEvidence:
    mistake = stored.get("mistake")
    return kinds.IdentityEvidence(
        kind="identity",
        mistake=mistake if mistake in ("reversed", "swapped") else None,  # type: ignore[arg-type]  # one of both
        partner=text(stored.get("partner")),
        last_data_before_at=moment(stored.get(BEFORE)),
        first_data_after_at=moment(stored.get(AFTER)),
        jump_1=number(stored.get("jump")),
        left_1=number(stored.get("left")),
        reason=text(stored.get("reason")),
        mounted=_mounted(stored.get(MOUNTED)),
        delays=_delays(stored),
    )


def _mounted(stored: JsonValue) -> kinds.MountedAs | None:
    if not isinstance(stored, list) or len(stored) != _MOUNTED_PARTS:
        return None
    vehicle, axle, since, turned = text(stored[0]), count(stored[1]), moment(stored[2]), stored[3]
    if vehicle is None or axle is None or since is None:
        return None
    return kinds.MountedAs(vehicle=vehicle, axle=axle, mounted_from=since, reversed=bool(turned))


def _hunting(stored: Stored) -> kinds.HuntingEvidence:
    return kinds.HuntingEvidence(
        kind="hunting",
        hunting_windows=count(stored.get("hunting_windows")),
        windows=count(stored.get("windows")),
        frequency_hz=number(stored.get("frequency_hz")),
        wavelength_m=number(stored.get("wavelength_m")),
        amplitude_mm=number(stored.get("amplitude_mm")),
        speed_max_m_s=number(stored.get("speed_max_m_s")),
        **_of_rule(stored),
    )


def _suspension_change(stored: Stored) -> kinds.SuspensionChangeEvidence:
    return kinds.SuspensionChangeEvidence(
        kind="suspension_change",
        vehicle=text(stored.get("vehicle")),
        change_1=estimate(stored.get("change")),
        past_findings=count(stored.get("past_findings")),
        step_probability_1=number(stored.get("step_probability")),
        step_at=moment(stored.get("step_ns")),
        recent_findings=count(stored.get("recent_findings")),
        other_vehicles=count(stored.get("other_vehicles")),
        limit_1=number(stored.get("limit")),
        delays=_delays(stored),
    )


def _data_quality(stored: Stored) -> kinds.DataQualityEvidence:
    return kinds.DataQualityEvidence(
        kind="data_quality",
        implausible_windows=count(stored.get("implausible_windows")),
        windows=count(stored.get("windows")),
        reasons=counted(stored.get("reasons")),
        rejected_recordings=count(stored.get("rejected_recordings")),
        rejected_reasons=counted(stored.get("rejected_reasons")),
        **_of_rule(stored),
    )


def _low_adhesion(stored: Stored) -> kinds.LowAdhesionEvidence:
    listed = stored.get("stretches")
    stretches = [part(one) for one in listed] if isinstance(listed, list) else []
    ends = [(number(one.get("from_m")), number(one.get("to_m"))) for one in stretches]
    return kinds.LowAdhesionEvidence(
        kind="low_adhesion",
        track_section=text(stored.get("track_section")),
        stretches=[kinds.Stretch(from_m=a, to_m=b) for a, b in ends if a is not None and b is not None],
        friction_1=estimate(stored.get("friction")),
        passes=count(stored.get("passes")),
        windows=count(stored.get("windows")),
        measured_from=moment(stored.get("from_ns")),
        measured_to=moment(stored.get("to_ns")),
        limit_1=number(stored.get("limit")),
        delays=_delays(stored),
    )


def _weak_damper(stored: Stored) -> kinds.WeakDamperEvidence:
    return kinds.WeakDamperEvidence(
        kind="weak_damper",
        vehicle=text(stored.get("vehicle")),
        first_axle=count(stored.get("first_axle")),
        damping_share_1=estimate(stored.get("share")),
        windows=count(stored.get("windows")),
        measured_from=moment(stored.get("from_ns")),
        measured_to=moment(stored.get("to_ns")),
        limit_1=number(stored.get("limit")),
        **_of_rule(stored),
    )


def _unregistered_change(stored: Stored) -> kinds.UnregisteredChangeEvidence:
    listed = stored.get("causes")
    causes = [part(one) for one in listed] if isinstance(listed, list) else []
    return kinds.UnregisteredChangeEvidence(
        kind="unregistered_change",
        last_data_before_at=moment(stored.get(BEFORE)),
        first_data_behind_at=moment(stored.get(AFTER)),
        before_km=number(stored.get("before_km")),
        after_km=number(stored.get("after_km")),
        size_1=estimate(stored.get("size")),
        level_before_1=number(stored.get("level_before")),
        amplitude_mm=number(stored.get("amplitude_mm")),
        intervals_before=count(stored.get("intervals_before")),
        intervals_behind=count(stored.get("intervals_behind")),
        causes=[
            kinds.StepCause(cause=one["cause"], share_1=number(one.get("share")), left_1=number(one.get("left")))  # type: ignore[arg-type]  # one of them
            for one in causes
            if one.get("cause") in _CAUSES
        ],
        reason=text(stored.get("reason")),
        delays=_delays(stored),
    )


def _wheel_flat(stored: Stored) -> kinds.WheelFlatEvidence:
    wheel = stored.get("wheel")
    return kinds.WheelFlatEvidence(
        kind="wheel_flat",
        striking_windows=count(stored.get("striking_windows")),
        windows=count(stored.get("windows")),
        blow_m_s2=number(stored.get("blow_m_s2")),
        wheel="left" if wheel == "left" else "right" if wheel == "right" else None,
        turn_m=number(stored.get("turn_m")),
        speed_max_m_s=number(stored.get("speed_max_m_s")),
        **_of_rule(stored),
    )


def _fleet_alert(alert: Alert) -> kinds.FleetAlertEvidence:
    stored = alert.evidence
    listed = stored.get(WHEELSETS)
    return kinds.FleetAlertEvidence(
        kind="fleet_alert",
        more_than=count(stored.get("more_than")),
        within_hours=number(stored.get("within_hours")),
        member_count=count(stored.get(MEMBER_COUNT)) or 0,
        open_member_count=count(stored.get(OPEN_MEMBER_COUNT)) or 0,
        wheelsets=[str(serial) for serial in listed] if isinstance(listed, list) else [],
        members=f"/v1/alerts?fleet_alert={alert.alert_id}",
        delays=_delays(stored),
    )


def _other(stored: Stored) -> kinds.OtherEvidence:
    """Return what an unknown rule has stored, by what it is."""
    numbers: dict[str, float | None] = {}
    texts: dict[str, str] = {}
    times: dict[str, str] = {}
    for name, value in _leaves({key: value for key, value in stored.items() if key != DELAYS}):
        at = moment(value) if name.endswith("_ns") else None
        if at is not None:
            times[f"{name.removesuffix('_ns')}_at"] = at
        elif isinstance(value, (bool, str)):
            texts[name] = str(value)
        elif not name.endswith("_ns"):
            numbers[name] = number(value)
    return kinds.OtherEvidence(kind="other", numbers=numbers, texts=texts, times=times, delays=_delays(stored))


def _leaves(value: JsonValue, name: str = "") -> Iterator[tuple[str, JsonValue]]:
    """Yield the values inside a value, each with the names that lead to it."""
    if isinstance(value, Mapping):
        inner = [(str(key), item) for key, item in value.items()]
    elif isinstance(value, list):
        inner = [(str(index), item) for index, item in enumerate(value)]
    else:
        yield name, value
        return
    for key, item in inner:
        yield from _leaves(item, f"{name}.{key}" if name else key)


_READERS: Mapping[str, Callable[[Stored], kinds.Evidence]] = {
    "conicity_limit": _conicity_limit,
    "measure": _measure,
    "limit_forecast": _limit_forecast,
    "wheel_asymmetry": _wheel_asymmetry,
    "no_data": _no_data,
    "sensor_fault": _sensor_fault,
    "identity": _identity,
    "hunting": _hunting,
    "suspension_change": _suspension_change,
    "data_quality": _data_quality,
    "low_adhesion": _low_adhesion,
    "weak_damper": _weak_damper,
    "unregistered_change": _unregistered_change,
    "wheel_flat": _wheel_flat,
}
