"""What is on file decides what holds the level of rails; what cannot be used is said with its reason."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from alignment_job import DAY_NS, LENGTH, register, surveyed
from drawn_cells import AMPLITUDE, cell, wheel
from one_database import on_sqlite
from sqlalchemy import update

from bench.standing_clock import StandingClock
from estimation.contact.profiles import MeasuredProfiles, wheel_profile
from estimation.jobs import refresh_rails
from estimation.jobs.job import JobContext
from estimation.jobs.refresh_rails import (
    OF_ALL,
    OF_WHEELSETS,
    AnchorInputs,
    anchor_inputs,
    anchors,
    make_cells,
    store_cells,
)
from estimation.jobs.runner import run
from estimation.jobs.settings import JobSettings, KnownSection, RailsSettings
from estimation.jobs.steps import rail_cells
from estimation.jobs.steps.assumptions import Membership
from estimation.jobs.steps.rail_cells import LOST, wheelset_cells
from estimation.jobs.steps.rolling import Part
from estimation.values.geometry import IntervalDigest
from estimation.values.opinions import (
    SECTION_RAILS,
    WHEELSET_RAILS,
    RailKey,
    RailsFinding,
    StoredCell,
    WheelKey,
    WheelsFinding,
)
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import RollUp, RollUpKey, Side
from estimation.values.runs import EVERYTHING, Mark
from estimation.values.track import TrackSectionRecord
from estimation.values.trend import IdentityChange
from fleet_db.storage import SqlStorage
from fleet_db.stores.opinions import CELLS

WHY = Reason(ReasonCode.YAW_SPRING_DIFFERS, "another spring")
SECTIONS = ("S1", "S2", "S3")
PERIOD_NS = 180 * DAY_NS


def context(storage: SqlStorage, *known: KnownSection) -> JobContext:
    return JobContext(storage, StandingClock(10**15), "test", JobSettings(rails=RailsSettings(frozenset(known))))


def stored(of: WheelKey, section: str, conicity: float, *, period: int = 0, reason: Reason | None = None) -> StoredCell:
    made = cell(of, section, conicity, period=period)
    found = None if reason else made
    return StoredCell(of, made.rail, f"{of} {section} {period}"[:64], found, reason, 6, made.from_ns, made.to_ns)


def fleet(periods: int = 1, more: float = 0.05) -> list[StoredCell]:
    return [
        stored(wheel(f"W{n}", p), section, 0.2 + 0.02 * n + (more if section == "S2" else 0.0), period=p)
        for n in range(5)
        for p in range(periods)
        for section in ("S1", "S2")
    ]


@pytest.fixture
def registered(storage: SqlStorage) -> SqlStorage:
    register(storage, SECTIONS)
    return storage


def found(storage: SqlStorage, cells: Sequence[StoredCell], *known: KnownSection) -> None:
    with storage.write() as unit:
        unit.rails.drop_cells([(one.wheel, one.rail) for one in unit.rails.cells()])
        unit.rails.put_cells(cells)
    run(OF_ALL, context(storage, *known))


def section(storage: SqlStorage, code: str) -> RailsFinding:
    with storage.read() as unit:
        result = unit.results.latest(SECTION_RAILS, code)
    assert result is not None
    assert result.value is not None
    return result.value


def wheelset(storage: SqlStorage, serial: str) -> WheelsFinding:
    with storage.read() as unit:
        result = unit.results.latest(WHEELSET_RAILS, serial)
    assert result is not None
    assert result.value is not None
    return result.value


def inputs(storage: SqlStorage, cells: Sequence[StoredCell], *known: KnownSection) -> AnchorInputs:
    with storage.read() as unit:
        return anchor_inputs(unit, cells, context(storage, *known))


def measure(storage: SqlStorage, serial: str, *, shift: float = 0.0, at_ns: int = DAY_NS) -> None:
    profile = wheel_profile("P8")
    moved = replace(profile, z=profile.z + shift * np.linspace(0.0, 1.0, len(profile.z)))
    with storage.write() as unit:
        unit.registry.add_measured_profiles(MeasuredProfiles(serial, at_ns, 10.0, moved, profile, 0.1e-3))


@on_sqlite
def test_a_section_and_a_wheelset_of_which_all_is_refused_are_said_with_the_reason(registered: SqlStorage) -> None:
    refused = [stored(wheel(f"W{n}", 1), "S3", 0.3, reason=WHY) for n in range(2)]
    found(registered, [*fleet(), *refused], KnownSection("S1", 0))
    (period,) = section(registered, "S3").periods
    assert {one.reason for one in (*period.part, *period.reference_wheel, *period.excess)} == {WHY}
    assert (period.wheelsets, period.windows, period.to_ns) == (2, 12, DAY_NS)
    assert section(registered, "S3").no_trend == WHY
    newest = wheelset(registered, "W0").part  # not that of an earlier mileage interval
    assert (newest.wheel.interval, newest.sections) == (1, ("S3",))
    assert {one.reason for one in newest.conicity} == {WHY}
    assert section(registered, "S2").periods[0].part[0].value == pytest.approx(0.05, abs=2e-3)


@on_sqlite
def test_the_limit_is_that_of_the_newest_period_or_not_known(registered: SqlStorage) -> None:
    known = (KnownSection("S1", 0), KnownSection("S1", PERIOD_NS))
    found(registered, fleet(2, more=0.12), *known)
    record = section(registered, "S2")
    assert (record.exceeded, record.reported_amplitude) == (True, 3e-3)
    newest = [replace(one, cell=None, reason=WHY) for one in fleet(2, more=0.12) if one.rail == RailKey("S2", 1)]
    rest = [one for one in fleet(2, more=0.12) if one.rail != RailKey("S2", 1)]
    found(registered, [*rest, *newest], *known)
    record = section(registered, "S2")
    assert (record.exceeded, record.reported_amplitude) == (None, None)
    assert [one.wheelsets for one in record.periods] == [5, 5]


@on_sqlite
def test_a_damaged_cell_is_said_and_its_wheelset_is_looked_at_again(registered: SqlStorage) -> None:
    alone = stored(wheel("W4", 1), "S3", 0.3)
    found(registered, [*fleet(), alone], KnownSection("S1", 0))
    at = context(registered, KnownSection("S1", 0))
    looked = OF_WHEELSETS.inputs(at)
    for damage in ({"scalars": {}, "arrays": {"conicity": [1]}}, {"reason": [1]}, []):
        with registered.write() as unit:
            wanted = update(CELLS).where(CELLS.c.section == "S3").values(document=damage)
            unit.connection.execute(wanted)
            due = unit.marks.due(looked, 0)
            unit.marks.note(looked, {serial: Mark(one.seen, "") for serial, one in due.items()})
            unit.marks.forget(OF_ALL.name, [EVERYTHING])
        run(OF_ALL, at)
        with registered.read() as unit:
            assert set(unit.marks.due(looked, 0)) == {"W4"}
        why = section(registered, "S3").periods[0].part[0].reason
        assert why is not None
        assert why.code is ReasonCode.CELL_DAMAGED
        assert section(registered, "S2").periods[0].part[0].value == pytest.approx(0.05, abs=2e-3)
        with registered.read() as unit:
            assert [one.damaged for one in unit.rails.cells(["W4"])] == [False, False, True]


def sealed(baseline: int, first_ns: int, end_ns: int) -> Part:
    key = RollUpKey(baseline, 0, Side.WHOLE, "tables", "metro")
    return Part(RollUp(key, 1, windows=6, first_ns=first_ns, end_ns=end_ns, vehicles=("V0",), sealed=True))


def by_now(
    storage: SqlStorage, monkeypatch: pytest.MonkeyPatch, reason: Reason | None, *parts: Part
) -> tuple[StoredCell, ...]:
    """Return what has changed of the cells of W0, whose windows are purged."""
    place_of = {(part.roll_up.key.baseline, part.roll_up.key.interval): part for part in parts}
    intervals = {place: IntervalDigest("", 6, reason) for place in place_of}
    monkeypatch.setattr(rail_cells, "rolled", lambda *_: SimpleNamespace(parts=parts))
    monkeypatch.setattr(Membership, "assumed", lambda *_: "of the class still")
    monkeypatch.setattr("fleet_db.stores.geometries.GeometryStore.interval_digests", lambda *_: intervals)
    at = context(storage)
    with storage.read() as unit:
        changes = wheelset_cells(unit, ["W0"], at)["W0"]
    with storage.write() as unit:
        store_cells(unit, at, {"W0": (changes, make_cells(changes))})
    return changes.moved


@on_sqlite
def test_a_cell_of_purged_windows_follows_what_is_said_of_its_geometry(
    registered: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    known, part = stored(wheel("W0"), "S1", 0.2), sealed(0, 0, DAY_NS)
    with registered.write() as unit:
        unit.rails.put_cells([known])
    assert by_now(registered, monkeypatch, None, part) == ()
    (refused,) = by_now(registered, monkeypatch, WHY, part)
    assert (refused.reason, refused.usable) == (WHY, None)
    assert by_now(registered, monkeypatch, WHY, part) == ()
    (again,) = by_now(registered, monkeypatch, None, part)
    assert again.usable is not None


@on_sqlite
def test_a_damaged_cell_of_purged_windows_stays_damaged(
    registered: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    with registered.write() as unit:
        unit.rails.put_cells([stored(wheel("W0"), "S1", 0.2)])
        unit.connection.execute(update(CELLS).values(document={"arrays": 1}))
    (lost,) = by_now(registered, monkeypatch, None, sealed(0, 0, DAY_NS))
    assert (lost.digest, lost.damaged) == (LOST, False)
    assert lost.reason is not None
    assert lost.reason.code is ReasonCode.CELL_DAMAGED


@on_sqlite
def test_cells_of_purged_windows_go_with_their_profile_where_a_lathe_was_registered_later(
    registered: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What was the first profile is the second by now, and what was the second the third."""
    first, second = (stored(WheelKey("W0", n, 0), "S1", 0.2 + 0.1 * n, period=n) for n in (0, 1))
    with registered.write() as unit:
        unit.rails.put_cells([first, second])
    begins = [one.from_ns for one in (first, second)]
    parts = [sealed(n + 1, begin, begin + DAY_NS) for n, begin in enumerate(begins)]
    by_now(registered, monkeypatch, None, *parts)
    with registered.read() as unit:
        found = {one.wheel.baseline: one.usable for one in unit.rails.cells(["W0"])}
    assert {number: one and (one.wheel.baseline, one.conicity[0]) for number, one in found.items()} == {
        1: (1, 0.2),
        2: (2, pytest.approx(0.3)),
    }


@on_sqlite
def test_a_refused_cell_of_purged_windows_is_stored_with_its_numbers(registered: SqlStorage) -> None:
    refused = replace(stored(wheel("W0"), "S1", 0.2), reason=WHY)
    with registered.write() as unit:
        unit.rails.put_cells([refused])
        (back,) = unit.rails.cells(["W0"])
    assert back.reason == WHY
    assert back.cell is not None
    assert back.cell.conicity.tolist() == [0.2, 0.2]
    assert inputs(registered, [back], KnownSection("S1", 0)).known == frozenset()


@on_sqlite
def test_a_section_is_known_from_the_period_of_its_day_on_for_a_year(registered: SqlStorage) -> None:
    """Pins ``known_days``: day 354 is in period 1, and 365 days later is the last day of period 3."""
    cells = fleet(6)
    day_ns = PERIOD_NS + 170 * DAY_NS
    for later, periods in ((4 * DAY_NS, {1, 2, 3}), (5 * DAY_NS, {1, 2, 3, 4}), (10 * DAY_NS, {2, 3, 4})):
        known = inputs(registered, cells, KnownSection("S1", day_ns + later))
        assert {key.period for key in known.known} == periods
        assert known.other["S1"].code is ReasonCode.KNOWN_RAILS_OTHER_TIME
    again = inputs(registered, cells, KnownSection("S1", day_ns), KnownSection("S1", 5 * PERIOD_NS))
    assert {key.period for key in again.known} == {1, 2, 3, 5}
    assert not again.other


@on_sqlite
def test_rails_that_were_known_long_ago_are_measured_by_the_others(registered: SqlStorage) -> None:
    found(registered, fleet(6), KnownSection("S1", 0), KnownSection("S2", 5 * PERIOD_NS))
    record = section(registered, "S1")
    assert record.refused is not None
    assert record.refused.code is ReasonCode.KNOWN_RAILS_OTHER_TIME
    assert record.periods[0].part[0].std == 0.0
    assert record.periods[-1].part[0].value == pytest.approx(-0.05, abs=2e-3)


@on_sqlite
def test_the_gauge_on_file_of_a_known_section_counts(registered: SqlStorage) -> None:
    """Rails 1 mm narrower are what wheels are compared on; the excess there is known."""
    track = replace(surveyed(), section="S1")
    with registered.write() as unit:
        unit.tracks.add_alignment(replace(track, gauge_deviation=np.full(len(track.s), -1e-3)))
    known = inputs(registered, fleet(), KnownSection("S1", 0))
    assert known.rails is not None
    assert known.rails.gauge == pytest.approx(1.434)
    held = anchors(known, AMPLITUDE)
    on_file, here = held.wheel.of("S1"), held.wheel.on_reference
    assert np.abs(here - on_file).max() > 0.02
    found(registered, fleet(), KnownSection("S1", 0))
    for one, expected in zip(section(registered, "S1").periods[0].excess, here - on_file, strict=True):
        assert one.value in (pytest.approx(expected), None)


@on_sqlite
@pytest.mark.parametrize(("narrower", "alike"), [(0.25e-3, True), (0.45e-3, False)])
def test_known_sections_of_another_gauge_hold_nothing(registered: SqlStorage, narrower: float, *, alike: bool) -> None:
    """Pins ``JOBS.gauge_tolerance``."""
    track = replace(surveyed(), section="S2")
    with registered.write() as unit:
        unit.tracks.add_alignment(replace(track, gauge_deviation=np.full(len(track.s), -narrower)))
    known = inputs(registered, fleet(), KnownSection("S1", 0), KnownSection("S2", 0))
    assert len({key.section for key in known.known}) == (2 if alike else 1)
    assert {why.code for why in known.other.values()} == (set() if alike else {ReasonCode.KNOWN_RAILS_OTHER})


@on_sqlite
def test_a_corrected_profile_of_the_same_time_is_noticed(registered: SqlStorage) -> None:
    texts = []
    for shift in (0.0, 1e-4):
        measure(registered, "W1", shift=shift)
        texts.append(inputs(registered, fleet()).text)
    assert texts[0] != texts[1]


@on_sqlite
def test_profiles_of_before_an_identity_change_are_not_those_of_the_wheels_after_it(
    registered: SqlStorage, monkeypatch: pytest.MonkeyPatch
) -> None:
    measure(registered, "W1", at_ns=3 * DAY_NS)
    for change, count in (
        (None, 1),
        (IdentityChange(DAY_NS, 2 * DAY_NS), 0),  # the cells are of before, the profiles of after
        (IdentityChange(4 * DAY_NS, 5 * DAY_NS), 1),
        (IdentityChange(2 * DAY_NS, 4 * DAY_NS), 0),  # measured within the change
    ):
        monkeypatch.setattr(refresh_rails, "last_break", lambda *_, found=change: found)
        assert len(inputs(registered, fleet()).measured) == count


@on_sqlite
def test_a_measured_wheelset_that_holds_no_level_says_why(registered: SqlStorage) -> None:
    for serial in ("W0", "W4"):  # both as new, but their conicities differ by 0.08
        measure(registered, serial)
    found(registered, fleet())
    why = {serial: wheelset(registered, serial).refused for serial in ("W0", "W1", "W4")}
    assert {serial: one.code for serial, one in why.items() if one is not None} == {
        "W0": ReasonCode.MEASURED_WHEELS_DIFFER,
        "W4": ReasonCode.MEASURED_WHEELS_DIFFER,
    }


@on_sqlite
def test_sections_of_another_rail_are_not_known(registered: SqlStorage) -> None:
    with registered.write() as unit:
        unit.tracks.add_section(TrackSectionRecord("S1", 1, "Section", "60E1", 0.025, 1.435, LENGTH))
    known = inputs(registered, fleet(), KnownSection("S1", 0), KnownSection("S2", 0))
    assert {why.code for why in known.other.values()} == {ReasonCode.KNOWN_RAILS_OTHER}
