"""The rules over records of the registry, each at both sides of its boundary."""

from __future__ import annotations

import pytest

from estimation.motion.mileage import most_km
from estimation.values.registry import Mounting
from ingest.registry_entry.checks import (
    AHEAD_NS,
    MILEAGE,
    ODOMETER,
    TOLERANCE_KM,
    DistancePoint,
    before_first_mounting,
    distance_contradictions,
    in_the_future,
    mounted_after_reprofiling,
    unknown_profile,
    unusable_code,
    unusual_gauge,
    unusual_radius,
)
from ingest.registry_entry.contents import Kind, RecordName, Rule

DAY = 86_400 * 10**9
NOW = 20_000 * DAY
TURNED = RecordName(Kind.REPROFILING, "W", NOW)


def point(at_ns: int, km: float, kind: Kind = Kind.REPROFILING) -> DistancePoint:
    return DistancePoint(RecordName(kind, "W", at_ns), at_ns, km, "mileage_km")


def mounting(from_ns: int) -> Mounting:
    return Mounting("W", "V", 1, from_ns, None, 0.0, 0.0)


@pytest.mark.parametrize(("ahead_ns", "refused"), [(AHEAD_NS, False), (AHEAD_NS + 1, True)])
def test_a_day_ahead_of_our_clock_is_the_future(ahead_ns: int, *, refused: bool) -> None:
    found = in_the_future(TURNED, "at", NOW + ahead_ns, NOW)
    assert [one.rule for one in found] == [Rule.IN_THE_FUTURE] * refused
    assert all("our clock shows 2024-10-04T00:00:00Z" in one.reason for one in found)


@pytest.mark.parametrize(("from_ns", "refused"), [(NOW, False), (NOW + 1, True)])
def test_nothing_is_turned_before_it_is_mounted(from_ns: int, *, refused: bool) -> None:
    later = mounting(NOW + 5 * DAY)
    found = before_first_mounting(TURNED, [later, mounting(from_ns)])
    assert [one.others for one in found] == [(RecordName(Kind.MOUNTING, "W", from_ns),)] * refused
    assert before_first_mounting(TURNED, []) == []
    found = mounted_after_reprofiling(mounting(from_ns), [NOW, NOW + 9 * DAY])
    assert [one.others for one in found] == [(TURNED,)] * refused


@pytest.mark.parametrize(
    ("known_km", "rule"),
    [
        (5000.0 + TOLERANCE_KM, None),
        (5000.1 + TOLERANCE_KM, Rule.MILEAGE_BACKWARDS),
        (5000.0 - TOLERANCE_KM - most_km(86_400.0), None),
        (4999.9 - TOLERANCE_KM - most_km(86_400.0), Rule.MILEAGE_JUMP),
    ],
)
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_mileage_runs_forwards_and_no_faster_than_a_vehicle(
    known_km: float, rule: Rule | None, *, mirrored: bool
) -> None:
    before, after = point(NOW - DAY, known_km, Kind.WINDOW), point(NOW, 5000.0)
    entered, known = (before, after) if mirrored else (after, before)
    found = distance_contradictions(entered, [known, entered], MILEAGE)
    assert [(one.rule, one.others) for one in found] == ([] if rule is None else [(rule, (known.record,))])


@pytest.mark.parametrize(("known_km", "refused"), [(5000.0 + TOLERANCE_KM, False), (5000.1 + TOLERANCE_KM, True)])
def test_one_time_has_one_mileage(known_km: float, *, refused: bool) -> None:
    for one, other in ((5000.0, known_km), (known_km, 5000.0)):
        found = distance_contradictions(point(NOW, one), [point(NOW, other, Kind.MEASUREMENT)], ODOMETER)
        assert [one.rule for one in found] == [Rule.ODOMETER_BACKWARDS] * refused


def test_what_is_contradicted_is_named() -> None:
    (found,) = distance_contradictions(point(NOW, 1000.0), [point(NOW - DAY, 389_401.0, Kind.WINDOW)], MILEAGE)
    assert found.reason == (
        "1,000 km: the mileage would run backwards, there is 389,401 km by the window of wheelset 'W' "
        "at 2024-10-03T00:00:00Z"
    )


@pytest.mark.parametrize(
    ("radius_mm", "words"),
    [(139.9, "139.9 mm: radii"), (140.0, None), (650.0, None), (650.1, "650.1 mm: a diameter?"), (920.0, "diameter?")],
)
def test_a_radius_is_one_of_a_railway_wheel(radius_mm: float, words: str | None) -> None:
    found = unusual_radius(RecordName(Kind.WHEELSET, "W"), 1e-3 * radius_mm)
    assert len(found) == (words is not None)
    assert all(words in one.reason for one in found if words)


@pytest.mark.parametrize(
    ("gauge_mm", "refused"), [(1000.0, True), (1379.9, True), (1380.0, False), (1435.0, False), (1480.1, True)]
)
def test_a_gauge_is_one_that_some_vehicle_runs_on(gauge_mm: float, *, refused: bool) -> None:
    found = unusual_gauge(RecordName(Kind.SECTION, "S"), 1e-3 * gauge_mm, [1.5, 1.7])
    assert [one.rule for one in found if gauge_mm < 1480] == [Rule.UNUSUAL_GAUGE] * (refused and gauge_mm < 1480)
    assert unusual_gauge(RecordName(Kind.SECTION, "S"), 1.0, []) == []
    assert not unusual_gauge(RecordName(Kind.SECTION, "S"), 1.48, [1.5])
    assert unusual_gauge(RecordName(Kind.SECTION, "S"), 1.4801, [1.5])


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("WS-0001", None),
        ("=1+1", None),
        ("<b>ä 7_7</b>", "divides paths"),
        ("A/B", "divides paths"),
        ("A\\B", "divides paths"),
        ("A__B", "file name"),
        ("A\x85B", "cannot be seen"),
        ("A\u202eB", "cannot be seen"),
        ("A\u200bB", "cannot be seen"),
        (" A", "blank"),
        ("A ", "blank"),
    ],
)
def test_a_new_code_can_be_written_in_a_path_and_read(code: str, words: str | None) -> None:
    found = unusable_code(RecordName(Kind.WHEELSET, code), "serial")
    assert len(found) == (words is not None)
    assert all(words in one.reason for one in found if words)


@pytest.mark.parametrize(
    ("field", "name", "known"),
    [
        ("wheel_profile", "P8", True),
        ("wheel_profile", "s1002", True),
        ("wheel_profile", "60E1", False),
        ("rail_profile", "60E1", True),
        ("rail_profile", "P8", False),
    ],
)
def test_a_profile_is_of_its_kind(field: str, name: str, *, known: bool) -> None:
    found = unknown_profile(RecordName(Kind.WHEELSET, "W"), field, name)
    assert [one.field for one in found] == [] if known else [field]
    assert all(f"named {name!r}; known: " in one.reason for one in found)
