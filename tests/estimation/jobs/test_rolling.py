"""Roll-ups: whatever happens to windows, they hold the sum of their tables in the order of time, bit for bit."""

from __future__ import annotations

import random
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
from alignment_job import counts
from executed_statements import executed_statements
from paper_class import PAPER_CLASS, WINDOWS
from section_runs import windows
from smooth_wheelset import alignment, track

from bench.put_values import put_table
from estimation.jobs.settings import EstimationSettings, JobSettings
from estimation.jobs.steps import rolling
from estimation.jobs.steps.assumptions import ClassLookup, Membership, membership
from estimation.jobs.steps.rolling import rolled, sums
from estimation.motion.mileage import running_mileage
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import TableSum, bin_parameters, cells_of_window, init
from estimation.values.geometry import BinTable, FilledCells
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord
from estimation.values.roll_up import RollUpState
from estimation.values.track import TrackSectionRecord
from estimation.values.windows import DueStage, Window, WindowState
from fleet_db.packed_values import pack_bin_table
from fleet_db.storage import SqlStorage

SETTINGS = JobSettings(estimation=EstimationSettings(interval_km=20.0, half_life_km=30.0))
MINUTE = 60 * 10**9
BINS = bin_parameters(WINDOWS)


@pytest.fixture(scope="module")
def tables() -> list[BinTable]:
    """Return bin tables of some real windows."""
    on = alignment(track(1))
    found = [cells_of_window(window, on, WINDOWS) for number in (1, 2, 4) for window in windows(number)]
    return [cells.table() for cells in found if isinstance(cells, FilledCells)]


def register(storage: SqlStorage) -> None:
    with storage.write() as unit:
        unit.registry.add_vehicle_class(PAPER_CLASS, 1)
        unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        unit.tracks.add_section(TrackSectionRecord("S1", 1, "Section", "56E1", 0.05, 1.435, 2900.0))
        unit.registry.add_vehicle(VehicleRecord("V1", "F", "paper", 1, 40.0, (0.0,)))
        unit.registry.add_wheelset(WheelsetRecord("W1", "F", "P8", 0.45, None))
        unit.registry.add_mounting(Mounting("W1", "V1", 1, 0, None, 0.0, 0.0))


@dataclass
class Life:
    """What may happen to the windows of a wheelset, in the order of a seed; a step is a minute and 1.2 km."""

    storage: SqlStorage
    tables: list[BinTable]
    dice: random.Random
    left: list[int] = field(default_factory=lambda: list(range(400)))
    there: set[int] = field(default_factory=set)

    def window(self, step: int) -> Window:
        one = windows(1)[0]
        speed = one.speed + 1e-6 * step  # so that each has content of its own
        return replace(one, wheelset="W1", vehicle="V1", start_ns=step * MINUTE, speed=speed)

    def put(self, unit: UnitOfWork, step: int, *, mileage_km: float | None = None) -> None:
        window = self.window(step)
        unit.windows.put(window, 1.2 * step if mileage_km is None else mileage_km, 1)
        record = unit.windows.get("W1", window.start_ns)
        assert record is not None
        put_table(unit, "W1", window.start_ns, self.dice.choice(self.tables), None, record.content_digest)
        unit.windows.mark("W1", window.start_ns, WindowState.ESTIMATED)
        self.there.add(step)

    def appended(self, unit: UnitOfWork) -> None:
        first = max(self.there, default=-1) + 1
        for step in range(first, first + self.dice.randint(1, 40)):
            if self.dice.random() < 0.9:
                self.put(unit, step)

    def late(self, unit: UnitOfWork) -> None:
        missing = sorted(set(range(max(self.there, default=0))) - self.there)
        for step in self.dice.sample(missing, min(3, len(missing))):
            self.put(unit, step)

    def estimated_again(self, unit: UnitOfWork) -> None:
        for step in self.some():
            record = unit.windows.get("W1", step * MINUTE)
            assert record is not None
            put_table(unit, "W1", step * MINUTE, self.dice.choice(self.tables), 2, record.content_digest)

    def newest_again(self, unit: UnitOfWork) -> None:
        if self.there:
            self.put(unit, max(self.there))

    def refused(self, unit: UnitOfWork) -> None:
        for step in self.some():
            unit.windows.mark("W1", step * MINUTE, WindowState.REFUSED, Reason(ReasonCode.INTERRUPTED, "no"))
            self.there.discard(step)

    def removed(self, unit: UnitOfWork) -> None:
        for step in [*self.some(), *sorted(self.there)[-1:]]:
            record = unit.windows.get("W1", step * MINUTE)
            if record is not None:
                unit.assembled.remove([record])
            self.there.discard(step)

    def other_mileage(self, unit: UnitOfWork) -> None:
        for step in self.some():
            unit.windows.put(self.window(step), 1.2 * step + self.dice.choice((0.1, 0.3, -500.0, 1e12)), 1)

    def turned(self, unit: UnitOfWork) -> None:
        if self.there and self.dice.random() < 0.3:
            step = self.dice.choice(sorted(self.there))
            unit.registry.add_reprofiling(Reprofiling("W1", step * MINUTE + 1, 1.2 * step, "lathe"), 1)

    def some(self) -> list[int]:
        return self.dice.sample(sorted(self.there), min(2, len(self.there)))


EVENTS: list[Callable[[Life, UnitOfWork], None]] = [
    Life.appended,
    Life.appended,
    Life.late,
    Life.estimated_again,
    Life.newest_again,
    Life.refused,
    Life.removed,
    Life.other_mileage,
    Life.turned,
]


def rules_of(unit: UnitOfWork) -> Membership:
    return membership(unit, "W1", ClassLookup(unit, SETTINGS.estimation))


def exact(storage: SqlStorage) -> dict[object, tuple[object, ...]]:
    """Return every roll-up as it is now, with what waits added, by its key."""
    with storage.read() as unit:
        parts = rolled(unit, rules_of(unit)).parts
        return {
            part.roll_up.key: (replace(part.roll_up, number=None), *map(pack_bin_table, sums(unit, "W1", part)))
            for part in parts
        }


def by_the_book(storage: SqlStorage) -> dict[tuple[int, int], tuple[BinTable, BinTable, list[float]]]:
    """Return table by table, in the order of time, what the sums should be: plain, forgetting, and mileages."""
    with storage.read() as unit:
        rules = rules_of(unit)
        found: defaultdict[tuple[int, int], list[tuple[float, BinTable]]] = defaultdict(list)
        for baseline in rules.baselines:
            entries = [(w, table) for w, table, _ in unit.tables.stream("W1", baseline.from_ns, baseline.to_ns)]
            mileages = running_mileage([window for window, _ in entries])
            for km, (_, table) in zip(mileages, entries, strict=True):
                found[baseline.number, int((km - baseline.mileage_km) // 20.0)].append((km, table))
        ends = {place: rules.baselines[place[0]].mileage_km + 20.0 * (place[1] + 1) for place in found}
    summed = {}
    for place, members in found.items():
        plain, forgetting = TableSum(init(BINS)), TableSum(init(BINS))
        for km, table in members:
            plain.add(table)
            w = 0.5 ** ((ends[place] - km) / 30.0)
            forgetting.add(table, w)
        summed[place] = plain.table(), forgetting.table(), [km for km, _ in members]
    return summed


def made_again(storage: SqlStorage) -> None:
    with storage.write() as unit:
        unit.roll_ups.put_states({"W1": RollUpState("", {})})
        unit.subjects.tables("W1")


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6))])
def test_after_anything_the_sums_are_those_of_the_tables_that_are_there(
    sqlite_storage: SqlStorage, tables: list[BinTable], seed: int
) -> None:
    register(sqlite_storage)
    life = Life(sqlite_storage, tables, random.Random(seed))  # noqa: S311 - an order of events
    for _ in range(9):
        for happens in life.dice.choices(EVENTS, k=2):
            with sqlite_storage.write() as unit:
                happens(life, unit)
        counts(sqlite_storage, "refresh_geometry", SETTINGS)
        kept, expected = exact(sqlite_storage), by_the_book(sqlite_storage)
        assert {(key.baseline, key.interval) for key in kept} == set(expected)
        with sqlite_storage.read() as unit:
            rules = rules_of(unit)
            for part in rolled(unit, rules).parts:
                plain, forgetting, mileages = expected[part.roll_up.key.baseline, part.roll_up.key.interval]
                found = sums(unit, "W1", part)
                assert pack_bin_table(found[0]) == pack_bin_table(plain)
                assert pack_bin_table(found[1]) == pack_bin_table(forgetting)
                assert part.roll_up.windows == len(mileages)
                assert part.roll_up.mean_km == pytest.approx(np.mean(mileages))
                assert part.roll_up.last_km == max(mileages)
        made_again(sqlite_storage)
        assert counts(sqlite_storage, "refresh_geometry", SETTINGS)["geometries"] == 0  # the same inputs, the same
        assert exact(sqlite_storage) == kept


@pytest.mark.slow
def test_one_more_window_costs_itself(
    sqlite_storage: SqlStorage, tables: list[BinTable], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tables added and statements executed are the same after 70 windows and after 300; a late one costs its interval.

    An interval of 20 km has 17 windows at most.
    """
    monkeypatch.setattr(rolling, "WORK", replace(rolling.WORK, rolled_together=1))
    register(sqlite_storage)
    life = Life(sqlite_storage, tables, random.Random(1))  # noqa: S311
    costs = []
    for until in (70, 300):
        with sqlite_storage.write() as unit:
            for step in range(max(life.there, default=-1) + 1, until):
                if step not in {45, 250}:
                    life.put(unit, step)
        counts(sqlite_storage, "refresh_geometry", SETTINGS)
        for step in (until, until + 1):
            with sqlite_storage.write() as unit:
                life.put(unit, step)
            spent = cost(sqlite_storage, monkeypatch)
        with sqlite_storage.write() as unit:
            life.put(unit, until - 50 if until == 300 else 45)
        costs.append((spent, cost(sqlite_storage, monkeypatch)))
    assert costs[0][0] == costs[1][0]
    assert costs[0][0][0] == 1
    assert all(15 <= late[0] <= 17 for _, late in costs)


def cost(storage: SqlStorage, monkeypatch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Return how many tables were added and how many statements executed by a run."""
    added = [0]
    original = TableSum.add

    def add(self: TableSum, table: BinTable | FilledCells, weight: float = 1.0) -> None:
        added[0] += isinstance(table, FilledCells)
        original(self, table, weight)

    with monkeypatch.context() as patch, executed_statements() as executed:
        patch.setattr(TableSum, "add", add)
        counts(storage, "refresh_geometry", SETTINGS)
    return added[0] // 2, len(executed)


@pytest.mark.slow
def test_few_windows_wait_before_their_sums_are_written(sqlite_storage: SqlStorage, tables: list[BinTable]) -> None:
    register(sqlite_storage)
    life = Life(sqlite_storage, tables, random.Random(2))  # noqa: S311
    waiting = []
    for step in range(40):
        with sqlite_storage.write() as unit:
            life.put(unit, step)
        counts(sqlite_storage, "refresh_geometry", SETTINGS)
        with sqlite_storage.read() as unit:
            waiting.append(len(unit.due.of_wheelset(DueStage.SUMS, "W1")))
            geometry = unit.geometries.current("W1")
        assert geometry is not None
        assert geometry.geometry.windows == step + 1
    assert waiting == [0, *range(1, 32), 0, *range(1, 8)]
