"""What has been purged stays counted: sums without tables give the same geometry, and say where they are wrong."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import replace

import pytest
from alignment_job import counts
from paper_class import PAPER_CLASS
from stored_raw import raw_of
from test_rolling import MINUTE, SETTINGS, Life, exact, made_again, register, tables

from bench.put_values import put_geometry, put_mountings, put_table
from estimation.errors import ConflictError
from estimation.jobs.steps import rolling
from estimation.values.geometry import PASSED_OVER, BinTable, GeometryRecord
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, Reprofiling, WheelsetRecord
from estimation.values.roll_up import RolledPart
from estimation.values.track import EpochMember, FoldState, TrackEpoch
from estimation.values.units import DAY_NS
from estimation.values.windows import PassedOver, WindowPosition, WindowState
from fleet_db.keeping.checks import check_deep
from fleet_db.keeping.purge import purge
from fleet_db.keeping.retention import Kept, Retention
from fleet_db.packed_values import pack_geometry
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlStorage
from fleet_db.stores.registry_history import RecordKey

__all__ = ["tables"]  # a fixture
OLD = 95  # steps: older ones are purged
NOTHING = dict.fromkeys((kind.value for kind in Kept), None)
BOTH = Retention(**(NOTHING | {"window_samples": 1.0, "window_bin_tables": 1.0}))
SAMPLES = Retention(**(NOTHING | {"window_samples": 1.0}))


@pytest.fixture(autouse=True)
def _rolled_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rolling, "WORK", replace(rolling.WORK, rolled_together=1))


def purged(storage: SqlStorage, until: int = OLD, retention: Retention = BOTH) -> dict[str, int]:
    """Return how much a purge deletes of the windows before a step."""
    done = purge(storage, raw_of(storage), retention, DAY_NS + until * MINUTE, lambda: None)
    return {one.kind.value: one.items for one in done}


def refresh(storage: SqlStorage) -> int:
    return counts(storage, "refresh_geometry", SETTINGS)["geometries"]


def geometries(storage: SqlStorage) -> dict[int | None, GeometryRecord]:
    with storage.read() as unit:
        current = unit.geometries.current("W1")
        assert current is not None
        oldest = [one for one in unit.geometries.intervals("W1") if one.baseline == 0]
        return {one.interval: one for one in [*oldest, current]}


def begin(storage: SqlStorage, tables: list[BinTable], steps: Sequence[int]) -> Life:
    register(storage)
    life = Life(storage, tables, random.Random(4))  # noqa: S311 - an order of events
    with storage.write() as unit:
        for step in steps:
            life.put(unit, step)
    refresh(storage)
    return life


@pytest.fixture
def life(filled_storage: Callable[[Callable[[SqlStorage], object]], SqlStorage], tables: list[BinTable]) -> Life:
    """Return a life of 130 steps, whose sums are made."""
    steps = range(130)

    def begin_life(storage: SqlStorage) -> None:
        begin(storage, tables, steps)

    found = Life(filled_storage(begin_life), tables, random.Random(4), there=set(steps))  # noqa: S311 - the same
    for _ in steps:
        found.dice.choice(tables)
    return found


def sealed_keys(storage: SqlStorage) -> set[int]:
    with storage.read() as unit:
        return {one.key.interval for one in unit.roll_ups.of("W1") if one.sealed}


def passed_over(storage: SqlStorage) -> dict[int, PassedOver]:
    with storage.read() as unit:
        return {start_ns // MINUTE: what for start_ns, what in unit.windows.passed_over("W1")}


def test_sums_without_tables_give_the_same_geometry_bit_for_bit(life: Life) -> None:
    sqlite_storage = life.storage
    before, sums = geometries(sqlite_storage), exact(sqlite_storage)
    assert purged(sqlite_storage) == {"window_samples": 95, "window_bin_tables": 84}  # whole intervals of 20 km
    assert sealed_keys(sqlite_storage) == {0, 1, 2, 3, 4}
    assert purged(sqlite_storage) == {"window_samples": 0, "window_bin_tables": 0}
    assert len(list(sqlite_storage.data_dir.rglob("*.window"))) == 130  # they have just been written
    assert not [
        one for one in check_deep(sqlite_storage, raw_of(sqlite_storage), lambda *_: None).findings if not one.harmless
    ]
    with sqlite_storage.write() as unit:
        unit.subjects.tables("W1")
    assert refresh(sqlite_storage) == 0
    made_again(sqlite_storage)
    assert refresh(sqlite_storage) == 0
    found = exact(sqlite_storage)
    assert [value[1:] for value in found.values()] == [value[1:] for value in sums.values()]
    with sqlite_storage.write() as unit:
        put_geometry(unit, replace(before[0], input_digest="0" * 64))
        unit.subjects.tables("W1")
    assert refresh(sqlite_storage) == 1
    assert pack_geometry(geometries(sqlite_storage)[0].geometry) == pack_geometry(before[0].geometry)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_late_windows_are_added_to_sums_without_tables(
    sqlite_storage: SqlStorage, tables: list[BinTable], seed: int
) -> None:
    """The same windows give the same sums, whether tables have been purged between them or not."""
    dice = random.Random(seed)  # noqa: S311
    late = dice.sample(range(80), 12)
    life = begin(sqlite_storage, tables, [step for step in range(130) if step not in late])
    purged(sqlite_storage)
    for step in late:
        with sqlite_storage.write() as unit:
            life.dice.seed(step)
            life.put(unit, step)
        refresh(sqlite_storage)
    purged(sqlite_storage)
    with sqlite_storage.write() as unit:
        life.put(unit, 130)
    refresh(sqlite_storage)
    with sqlite_storage.read() as unit:
        assert sum(one.windows for one in unit.roll_ups.of("W1")) == 131
        assert {one.record.start_ns // MINUTE for one in unit.tables.tabled("W1")} == set(range(84, 131))
    kept = exact(sqlite_storage)
    made_again(sqlite_storage)
    refresh(sqlite_storage)
    assert exact(sqlite_storage) == kept
    assert not passed_over(sqlite_storage)


def test_a_window_that_is_late_for_sums_without_tables_is_in_them_once(
    sqlite_storage: SqlStorage, tables: list[BinTable]
) -> None:
    life = begin(sqlite_storage, tables, [step for step in range(130) if step != 40])
    purged(sqlite_storage)
    for table in tables[:2]:  # the second time it is estimated again, as long as it has samples
        with sqlite_storage.write() as unit:
            if table is tables[0]:
                life.put(unit, 40)
            record = unit.windows.get("W1", 40 * MINUTE)
            assert record is not None
            put_table(unit, "W1", 40 * MINUTE, table, 2, record.content_digest)
        refresh(sqlite_storage)
        with sqlite_storage.read() as unit:
            assert sum(one.windows for one in unit.roll_ups.of("W1")) == 130
            assert 40 * MINUTE not in {one.start_ns for one in unit.tables.tabled("W1")}
    assert purged(sqlite_storage) == {"window_samples": 1, "window_bin_tables": 0}


def test_a_fuller_recording_replaces_a_window_until_its_table_is_purged(life: Life) -> None:
    sqlite_storage = life.storage
    purged(sqlite_storage, retention=SAMPLES)
    with sqlite_storage.write() as unit:
        assert not unit.windows.put(life.window(50), 60.0, 2)  # the same again
        assert unit.windows.put(replace(life.window(51), speed=life.window(52).speed), 61.2, 2)
        record = unit.windows.get("W1", 51 * MINUTE)
        assert record is not None
        assert record.state is WindowState.PENDING
        assert unit.windows.load("W1", 51 * MINUTE).speed[0] == life.window(52).speed[0]
    assert purged(sqlite_storage)["window_bin_tables"] == 0  # the former table is still to be taken away
    refresh(sqlite_storage)
    assert purged(sqlite_storage)["window_bin_tables"] == 83
    with sqlite_storage.write() as unit:
        before = unit.windows.get("W1", 10 * MINUTE)
        assert not unit.windows.put(replace(life.window(10), speed=life.window(11).speed), 12.0, 2)
        assert unit.windows.get("W1", 10 * MINUTE) == before
    assert passed_over(sqlite_storage) == {10: PassedOver.SUPERSEDED}
    assert refresh(sqlite_storage) >= 1
    found = geometries(sqlite_storage)[0]
    assert found.parameters[PASSED_OVER] == {"superseded": 1}
    assert found.geometry.reason is None or found.geometry.reason.code is not ReasonCode.SAMPLES_PURGED


def other_mileage(storage: SqlStorage, life: Life) -> None:
    with storage.write() as unit:
        assert not unit.windows.put(life.window(10), 30.0, 2)


def removed(storage: SqlStorage, _: Life) -> None:
    with storage.write() as unit:
        record = unit.windows.get("W1", 10 * MINUTE)
        assert record is not None
        assert unit.assembled.remove([record]) == []


def turned_round(storage: SqlStorage, _: Life) -> None:
    with storage.write() as unit:
        put_mountings(unit, [Mounting("W1", "V1", 1, 0, None, 0.0, 0.0, reversed=True)], 2)


def turned_on_a_lathe(storage: SqlStorage, _: Life) -> None:
    with storage.write() as unit:
        unit.registry.add_reprofiling(Reprofiling("W1", 10 * MINUTE + 1, 12.0, "late"), 2)


def heavier(storage: SqlStorage, _: Life) -> None:
    parameters = replace(PAPER_CLASS.parameters, suspended_mass=1.5 * PAPER_CLASS.parameters.suspended_mass)
    with storage.write() as unit:
        unit.registry.add_vehicle_class(replace(PAPER_CLASS, parameters=parameters), 2)


def other_radius(storage: SqlStorage, _: Life) -> None:
    with storage.write() as unit:
        unit.registry.add_wheelset(WheelsetRecord("W1", "F", "P8", 0.43, None), 2)


@pytest.mark.parametrize("happens", [other_mileage, removed, turned_round, turned_on_a_lathe, heavier, other_radius])
def test_a_correction_that_comes_too_late_leaves_no_wrong_number(
    life: Life,
    happens: object,
) -> None:
    sqlite_storage = life.storage
    purged(sqlite_storage)
    before = geometries(sqlite_storage)
    assert callable(happens)
    happens(sqlite_storage, life)
    refresh(sqlite_storage)
    found = geometries(sqlite_storage)
    reason = found[0].geometry.reason
    assert (found[0].geometry.status, reason and reason.code) == (Status.MODEL_MISMATCH, ReasonCode.SAMPLES_PURGED)
    assert found[0].geometry.windows == before[0].geometry.windows
    current = found[None].geometry.reason
    assert current is None or current.code is not ReasonCode.SAMPLES_PURGED or happens is turned_round
    with sqlite_storage.write() as unit:
        unit.subjects.tables("W1")
    assert refresh(sqlite_storage) == 0
    with sqlite_storage.write() as unit:
        life.put(unit, 130)
    refresh(sqlite_storage)


def test_an_early_correction_moves_sums_to_their_place(life: Life) -> None:
    """A lathe visit before all windows is another baseline for all of them; no number is lost, and none is twice."""
    sqlite_storage = life.storage
    purged(sqlite_storage)
    before = geometries(sqlite_storage)
    with sqlite_storage.write() as unit:
        unit.registry.add_reprofiling(Reprofiling("W1", -MINUTE, -5.0, "early"), 2)
    refresh(sqlite_storage)
    with sqlite_storage.read() as unit:
        found = {one.interval: one for one in unit.geometries.intervals("W1", 1)}
        gone = unit.geometries.intervals("W1", 0)
        assert sum(one.windows for one in unit.roll_ups.of("W1")) == 130
    assert [one.geometry.windows for one in gone] == [0] * 8
    assert sum(one.geometry.windows for one in found.values()) == 130
    for number in range(5):
        assert pack_geometry(found[number].geometry) == pack_geometry(before[number].geometry)
    with sqlite_storage.write() as unit:
        unit.corrections.void(
            RecordKey(RecordKind.REPROFILING, "W1", -MINUTE), Decision(reason="a mistake", recorded_ns=3)
        )
    refresh(sqlite_storage)
    again = geometries(sqlite_storage)
    assert [pack_geometry(again[n].geometry) for n in range(7)] == [pack_geometry(before[n].geometry) for n in range(7)]


def test_other_lengths_of_intervals_keep_sums_that_are_there(life: Life) -> None:
    sqlite_storage = life.storage
    purged(sqlite_storage)
    for length_km in (40.0, 10.0, 20.0):
        other = replace(SETTINGS, estimation=replace(SETTINGS.estimation, interval_km=length_km))
        with sqlite_storage.write() as unit:
            unit.subjects.tables("W1")
        counts(sqlite_storage, "refresh_geometry", other)
        with sqlite_storage.read() as unit:
            assert sum(one.windows for one in unit.roll_ups.of("W1")) == 130
            assert not [one for one in unit.geometries.intervals("W1") if contradicted(one)]
    assert len(life.there) == 130


def contradicted(record: GeometryRecord) -> bool:
    return record.geometry.reason is not None and record.geometry.reason.code is ReasonCode.SAMPLES_PURGED


def test_other_parameters_leave_what_cannot_be_made_again(life: Life) -> None:
    """Sums of other filters stay published, as they were right when they were made."""
    sqlite_storage = life.storage
    purged(sqlite_storage)
    before = geometries(sqlite_storage)
    signals = replace(SETTINGS.estimation.signals, cutoff_wavelength=41.0)
    other = replace(SETTINGS, estimation=replace(SETTINGS.estimation, signals=signals))
    done = counts(sqlite_storage, "estimate_windows", other)
    assert (done["requeued"], done["passed_over"]) == (35, 11)  # what is sealed is not looked at
    counts(sqlite_storage, "refresh_geometry", other)
    found = geometries(sqlite_storage)
    for n in range(5):
        assert pack_geometry(found[n].geometry) == pack_geometry(before[n].geometry)
    with sqlite_storage.read() as unit:
        kept = {one.key.interval: one.windows for one in unit.roll_ups.of("W1")}
    assert [kept[n] for n in range(5)] == [before[n].geometry.windows for n in range(5)]
    assert counts(sqlite_storage, "estimate_windows", other).get("passed_over", 0) == 0


def test_tables_of_an_interval_that_is_not_over_stay(life: Life) -> None:
    sqlite_storage = life.storage
    assert purged(sqlite_storage, 0) == {"window_samples": 0, "window_bin_tables": 0}
    tables_alone = Retention(**(NOTHING | {"window_bin_tables": 1.0}))
    assert purged(sqlite_storage, retention=tables_alone) == {"window_bin_tables": 0}  # they have samples
    with sqlite_storage.write() as unit:
        unit.windows.mark("W1", 3 * MINUTE, WindowState.PENDING)
        life.put(unit, 20, mileage_km=24.1)
    assert purged(sqlite_storage)["window_bin_tables"] == 0  # one is to be taken away
    refresh(sqlite_storage)
    assert purged(sqlite_storage)["window_bin_tables"] == 67
    assert sealed_keys(sqlite_storage) == {1, 2, 3, 4}


def test_a_roll_up_that_was_sealed_meanwhile_is_not_overwritten(life: Life) -> None:
    sqlite_storage = life.storage
    with sqlite_storage.read() as unit:
        seen = unit.roll_ups.of("W1")[0]
    purged(sqlite_storage)
    with sqlite_storage.read() as unit:
        assert seen.number is not None
        kept = unit.roll_ups.sums(seen.number)
    part = RolledPart(seen, seen.content, *kept, ())
    with pytest.raises(ConflictError), sqlite_storage.write() as unit:
        unit.roll_ups.put({"W1": [part]}, 1)
    assert life.there


def test_sums_with_forgetting_go_when_they_have_no_weight(life: Life) -> None:
    """20 half-lives of 30 km are 600 km: 500 steps."""
    sqlite_storage = life.storage
    purged(sqlite_storage)

    def kept() -> set[int]:
        with sqlite_storage.read() as unit:
            numbers = [(one.number, one.key.interval) for one in unit.roll_ups.of("W1")]
            sums = {interval: unit.roll_ups.sums(number or 0) for number, interval in numbers}
        return {interval for interval, found in sums.items() if found[1].windows}

    assert kept() == set(range(8))
    with sqlite_storage.write() as unit:
        life.put(unit, 534)  # 640.8 km, 600.8 km behind the end of the second interval
    refresh(sqlite_storage)
    refresh(sqlite_storage)
    assert kept() == {2, 3, 4, 5, 6, 7, 32}
    made_again(sqlite_storage)
    assert refresh(sqlite_storage) == 0


def test_where_sealed_windows_were_is_forgotten(life: Life) -> None:
    """Also of refused windows between them; the epochs are neither torn nor computed again."""
    sqlite_storage = life.storage
    with sqlite_storage.write() as unit:
        unit.windows.mark("W1", 5 * MINUTE, WindowState.REFUSED, Reason(ReasonCode.IN_CURVES, "why"))
        records = unit.windows.list("W1")
        for record in records:
            unit.tracks.put_positions([WindowPosition("W1", record.start_ns, record.content_digest, 1)])
        for number, first in enumerate(range(0, 130, 50), start=1):
            own = [EpochMember(record, "context", "assumed") for record in records[first : first + 50]]
            last_ns = own[-1].record.start_ns
            epoch = TrackEpoch("S1", number, "", "d", last_ns, len(own), waits=False, after=FoldState(None, None, None),
                               estimated_on=None, report=0, recorded_ns=1)  # fmt: skip
            unit.epochs.put(epoch, own)
    refresh(sqlite_storage)
    assert purged(sqlite_storage) == {"window_samples": 50, "window_bin_tables": 49}  # of the epoch that is over
    with sqlite_storage.read() as unit:
        assert [one.windows for one in unit.epochs.list("S1")] == [0, 50, 30]
        assert [one.stale for one in unit.epochs.list("S1")] == [False] * 3
        there = [step for step in range(130) if unit.tracks.position("W1", step * MINUTE) is not None]
    assert there == list(range(50, 130))
    assert len(life.there) == 130
