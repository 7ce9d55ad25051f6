"""What windows say of the rolling radius is summed up while they are estimated, of those that will be asked."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from test_isolation import NAMES, clock, counts, fleet, of
from wheelset_life import SetClock

from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.assumptions import Assumed, ClassLookup
from estimation.jobs.steps.load_window import likely_chosen
from estimation.motion.rolling_sums import rolling_sums
from estimation.values.roll_up import MOST_CHOSEN, RollingSums, WindowRollingSums
from estimation.values.windows import Hunting
from fleet_db.storage import SqlStorage

__all__ = ["clock", "fleet"]  # fixtures
PARTS = (RollingSums(np.ones((6, 7, 7)), np.zeros((6, 7, 7))),)


def test_a_geometry_needs_no_samples_of_windows_that_were_just_estimated(
    fleet: SqlStorage, clock: SetClock, tmp_path: Path
) -> None:
    assert counts(fleet, clock, "estimate_windows")["estimated"] == 6
    with fleet.read() as unit:
        for name in NAMES:
            assumed = ClassLookup(unit, EstimationSettings()).assumed(name, name)
            assert isinstance(assumed, Assumed)
            digests = {one.start_ns: one.content_digest for one in of(fleet, name)}
            found = unit.roll_ups.rolling(name, digests, assumed.digest)
            assert len(found) == 2
            for start_ns, parts in found.items():
                window = unit.windows.load(name, start_ns)
                expected = rolling_sums(
                    window, assumed.window_parameters.vehicle_class, assumed.window_parameters.signals
                )
                assert len(parts) == len(expected) > 0
                for one, other in zip(parts, expected, strict=True):
                    np.testing.assert_array_equal(one.products, other.products)
                    np.testing.assert_array_equal(one.noise, other.noise)
    for path in tmp_path.rglob("*.window"):
        path.unlink()
    assert counts(fleet, clock, "refresh_geometry") == {"wheelsets": 3, "geometries": 6, "quarantined": 0}


def test_only_windows_of_small_digests_are_likely_to_be_chosen(fleet: SqlStorage) -> None:
    (first, second) = of(fleet, "W0")
    small = [replace(first, start_ns=n, content_digest=f"{n:064x}") for n in range(MOST_CHOSEN)]
    large = replace(second, content_digest="f" * 64)
    hunting = replace(
        second, start_ns=99, content_digest="0" * 64, quality=replace(second.quality, hunting=Hunting(1.0, 3.0, 4e-3))
    )
    other = replace(large, wheelset="W1")
    with fleet.read() as unit:
        found = likely_chosen(unit, [*small[1:], hunting, large, other])
        assert found == {one.key for one in (*small[1:], large, other)}
        assert likely_chosen(unit, [*small, large, other]) == {one.key for one in (*small, other)}
        assert likely_chosen(unit, [hunting]) == set()


def test_windows_whose_sums_are_kept_count_as_chosen(fleet: SqlStorage) -> None:
    (record, _) = of(fleet, "W0")
    kept = [WindowRollingSums("W0", n, f"{n:064x}", "assumed", PARTS) for n in range(MOST_CHOSEN)]
    with fleet.write() as unit:
        unit.roll_ups.put_rolling(kept[1:])
        assert likely_chosen(unit, [record]) == {record.key}
        unit.roll_ups.put_rolling(kept)  # one of them new
        assert likely_chosen(unit, [record]) == set()
        assert likely_chosen(unit, [replace(record, wheelset="W1")]) == {("W1", record.start_ns)}
        unit.roll_ups.put_rolling([])


def test_the_windows_of_the_newest_roll_up_count_as_chosen(fleet: SqlStorage, clock: SetClock) -> None:
    counts(fleet, clock, "estimate_windows", "refresh_geometry")
    digests = sorted(one.content_digest for one in of(fleet, "W0"))
    with fleet.read() as unit:
        assert sorted(unit.roll_ups.newest_chosen(["W0", "no such"])["W0"]) == digests
        assert len(unit.roll_ups.of("W0")) == 1
