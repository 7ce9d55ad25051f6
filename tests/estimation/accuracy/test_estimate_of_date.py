"""Which estimate belongs to a measurement: its profile, its mileage, its wheelset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.accuracy.fleet_accuracy import EstimateOfDate, estimate_of_date
from estimation.contact.profiles import MeasuredProfiles, wheel_profile
from estimation.values.geometry import BinStatus, BinValues, GeometryRecord, WheelsetGeometry
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Reprofiling, WheelsetRecord
from estimation.values.trend import IdentityChange

DAY = 86_400 * 10**9
TURNED = 100 * DAY  # at 50,000 km
WHEELSET = WheelsetRecord("W", "F", "S1002", 0.46, None, (Reprofiling("W", TURNED, 50_000.0),))
KNOWN = Estimate(0.2, 0.01, 0.18, 0.22, 5.0, Status.ESTIMATED)
OPEN = Estimate.unknown(Reason(ReasonCode.TOO_FEW_BLOCKS, "3 blocks of data, 4 are needed"))


def record(
    baseline: int, interval: int, conicity: Estimate = KNOWN, *, mileage_km: float | None = None
) -> GeometryRecord:
    """Return the geometry of an interval of 1,000 km, driven in ten days."""
    nothing = BinValues(np.full(2, np.nan), np.full(2, np.nan), (BinStatus.TOO_FEW,) * 2)
    geometry = WheelsetGeometry(
        bin_edges=np.array([-1e-3, 0.0, 1e-3]),
        samples=np.ones(2),
        rolling_radius_sum=nothing,
        rolling_radius_difference=nothing,
        contact_angle_sum=nothing,
        contact_angle_difference=nothing,
        amplitude=np.array([3e-3]),
        conicity=(conicity,),
        reported_amplitude=3e-3,
        equivalent_conicity=conicity,
        nonlinearity=OPEN,
        zero_crossing=OPEN,
        windows=4,
        parameter_key="k",
        status=conicity.status,
    )
    begin = baseline * 50_000.0 + interval * 1000.0
    from_ns = baseline * TURNED + interval * 10 * DAY
    at_km = begin + 500.0 if mileage_km is None else mileage_km
    return GeometryRecord("W", baseline, interval, at_km, from_ns, from_ns + 10 * DAY, geometry, "d", {}, {}, "v", 1)


def at(km: float, at_ns: int) -> MeasuredProfiles:
    wheel = wheel_profile("S1002")
    return MeasuredProfiles("W", at_ns, km, wheel, wheel, 1e-4)


def chosen(
    measurement: MeasuredProfiles, *records: GeometryRecord, change: IdentityChange | None = None
) -> EstimateOfDate:
    return estimate_of_date(measurement, WHEELSET, records, 1000.0, change)


def test_it_is_that_of_the_interval_that_contains_the_mileage() -> None:
    records = [record(0, n) for n in range(5)]
    assert chosen(at(3999.0, 39 * DAY), *records).record is records[3]
    assert chosen(at(4000.0, 40 * DAY), *records).record is records[4]


@pytest.mark.parametrize(("days", "baseline"), [(-1, 0), (0, 1), (1, 1)])
def test_the_lathe_divides_profiles_whatever_the_mileage_is(days: int, baseline: int) -> None:
    before, after = record(0, 49), record(1, 0)
    found = chosen(at(50_000.0 - (baseline == 0), TURNED + days * DAY), before, after)
    assert found.record is (before, after)[baseline]
    assert found.reason is None


def test_an_interval_without_conicity_gives_way_to_the_nearest_that_has_one() -> None:
    own, earlier, later = record(0, 3, OPEN, mileage_km=3050.0), record(0, 2), record(0, 4, mileage_km=4100.0)
    assert chosen(at(3100.0, 31 * DAY), own, earlier, later).record is earlier
    assert chosen(at(3900.0, 31 * DAY), own, earlier, later).record is later
    alone = chosen(at(3100.0, 31 * DAY), own, record(0, 9))
    assert alone.record is own
    assert alone.reason is not None
    assert alone.reason.code is ReasonCode.TOO_FEW_BLOCKS


def test_why_there_is_none() -> None:
    def code(found: EstimateOfDate) -> ReasonCode | None:
        assert found.record is None
        return None if found.reason is None else found.reason.code

    assert code(chosen(at(60_000.0, 2 * TURNED), record(0, 3))) is ReasonCode.NO_GEOMETRY
    emptied = replace(record(0, 3), geometry=replace(record(0, 3).geometry, windows=0))
    assert code(chosen(at(3100.0, 31 * DAY), emptied)) is ReasonCode.NO_GEOMETRY
    far = chosen(at(20_000.0, 60 * DAY), record(0, 3), record(0, 17))
    assert code(far) is ReasonCode.NO_ESTIMATE_NEAR
    assert far.reason is not None
    assert "2500 km" in far.reason.text
    change = IdentityChange(35 * DAY, 36 * DAY)
    assert code(chosen(at(3900.0, 39 * DAY), record(0, 3), change=change)) is ReasonCode.IDENTITY_DOUBTFUL
    assert chosen(at(4100.0, 41 * DAY), record(0, 3), record(0, 4), change=change).record is not None
    assert chosen(at(2100.0, 21 * DAY), record(0, 2), record(0, 4), change=change).record is not None
