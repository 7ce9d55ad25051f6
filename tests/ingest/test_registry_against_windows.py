"""A mileage that windows contradict is refused: not by windows that are wrong themselves or will be made again."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest
from registry_files import DAY_NS, FILE, MOUNTED_NS, at, load, refused, window, written

from estimation.values.reasons import Reason, ReasonCode
from fleet_db.storage import SqlStorage
from ingest.registry_entry.contents import Rule

KM_A_DAY = 400.0


@pytest.fixture
def measured(storage: SqlStorage, tmp_path: Path) -> SqlStorage:
    """Return a storage with a window of W-1 every 5 days, the last after 100 days at 90,000 km."""
    load(storage, written(tmp_path, FILE))
    put(storage, [(day, 50_000.0 + KM_A_DAY * day) for day in range(0, 101, 5)])
    return storage


def put(storage: SqlStorage, mileages: Sequence[tuple[int, float]]) -> None:
    with storage.write() as unit:
        unit.stale_spans.remove(unit.stale_spans.all())
        for day, km in mileages:
            unit.windows.put(window("W-1", MOUNTED_NS + day * DAY_NS), km, 1)


def reprofiling(day: int, km: float) -> dict[str, object]:
    return {"reprofilings": [{"wheelset": "W-1", "at": at(day), "mileage_km": km}]}


@pytest.mark.parametrize(
    ("day", "km", "rule"),
    [
        (300, 1000.0, Rule.MILEAGE_BACKWARDS),
        (101, 88_999.0, Rule.MILEAGE_BACKWARDS),
        (101, 89_001.0, None),
        (52, 72_001.0 + 1000.0 + 10_000.0, Rule.MILEAGE_BACKWARDS),  # by the window of day 55
        (101, 90_000.0 + 540.0 + 3000.0 + 1001.0, Rule.MILEAGE_JUMP),
        (101, 90_000.0 + 540.0 + 3000.0 + 999.0, None),
    ],
)
def test_windows_contradict_what_is_far_from_them(
    measured: SqlStorage, tmp_path: Path, day: int, km: float, rule: Rule | None
) -> None:
    path = written(tmp_path, reprofiling(day, km))
    if rule is None:
        load(measured, path)
        return
    rules = [one.contradiction.rule for one in refused(measured, path).refusals if one.contradiction]
    assert rule in rules


def test_an_odometer_that_was_reset_contradicts_nobody(measured: SqlStorage, tmp_path: Path) -> None:
    put(measured, [(day, 10.0 + KM_A_DAY * (day - 105)) for day in range(105, 201, 5)])
    assert Rule.MILEAGE_BACKWARDS in [
        one.contradiction.rule
        for one in refused(measured, written(tmp_path, reprofiling(201, 1000.0))).refusals
        if one.contradiction
    ]
    load(measured, written(tmp_path, reprofiling(201, 128_000.0)))


def test_windows_that_are_not_believed_contradict_nobody(measured: SqlStorage, tmp_path: Path) -> None:
    put(measured, [(110, 9e6)])
    with measured.write() as unit:
        reason = Reason(ReasonCode.PROCESSING_FAILED, "odometer")
        unit.plausibility.judge({("W-1", MOUNTED_NS + 110 * DAY_NS): reason})
    load(measured, written(tmp_path, reprofiling(120, 95_000.0)))


def test_windows_of_a_mounting_that_is_put_right_contradict_nobody(measured: SqlStorage, tmp_path: Path) -> None:
    first = FILE["mountings"][0]
    load(measured, written(tmp_path, {"mountings": [first | {"wheelset_mileage_km": 450_000.0}]}))
    load(measured, written(tmp_path, reprofiling(101, 490_000.0)))


def test_the_odometer_of_other_axles_is_compared(measured: SqlStorage, tmp_path: Path) -> None:
    first = FILE["mountings"][0]

    def mounted(odometer_km: float) -> Path:
        entry = first | {"wheelset": "W-3", "axle": 2, "from": at(101), "vehicle_odometer_km": odometer_km}
        return written(tmp_path, {"mountings": [entry]})

    for odometer_km, rule in ((60_000.0, Rule.ODOMETER_BACKWARDS), (110_000.0, Rule.ODOMETER_JUMP)):
        error = refused(measured, mounted(odometer_km))
        assert [one.contradiction.rule for one in error.refusals if one.contradiction] == [rule]
        assert "by the window of wheelset 'W-1'" in str(error)
    load(measured, mounted(90_400.0))
