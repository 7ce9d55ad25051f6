"""The bin tables of a wheelset are summed by mileage interval, always in the order of vehicle time.

So the sums are the same bits whatever came when. Windows behind the last one of an interval are added to its stored
sums; where a window comes late, changes or goes, the interval is summed again from its tables.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections import defaultdict
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

from estimation.jobs.parameters import WORK
from estimation.jobs.steps.assumptions import Baseline, Membership
from estimation.motion.mileage import first_reading, known_mileage, read
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import TableSum
from estimation.values.geometry import BinTable
from estimation.values.roll_up import (
    APART,
    Member,
    Odometer,
    RollUp,
    RollUpKey,
    RollUpState,
    Side,
    TabledWindow,
    with_members,
)
from estimation.values.windows import DueStage

Run = tuple[TabledWindow, float]  # a window with the mileage that the wheelset had run
Place = tuple[int, int]  # baseline and interval


@dataclass(frozen=True, slots=True)
class Part:
    """A roll-up with what is to be added to its stored sums."""

    roll_up: RollUp
    added: tuple[Member, ...] = ()
    afresh: bool = False  # the stored sums do not count
    moved: bool = False  # its key is another
    before: str = ""  # digest of the content that is stored

    @property
    def changed(self) -> bool:
        """Whether something else is stored."""
        return bool(self.added or self.afresh or self.moved)

    @property
    def place(self) -> Place:
        """Its mileage interval."""
        return self.roll_up.key.baseline, self.roll_up.key.interval


def by_interval(parts: Iterable[Part]) -> dict[Place, Part]:
    """Return what stands for each mileage interval: after an identity change, of the class with most windows."""
    places: defaultdict[Place, list[Part]] = defaultdict(list)
    for part in parts:
        places[part.place].append(part)
    found = {}
    for place in sorted(places):
        after = [part for part in places[place] if part.roll_up.key.side is Side.AFTER]
        found[place] = max(after or places[place], key=lambda part: (part.roll_up.windows, part.roll_up.last_ns))
    return found


@dataclass(frozen=True, slots=True)
class Rolled:
    """The roll-ups of a wheelset as they should be, in the order of their keys, beside what is stored."""

    state: RollUpState
    parts: tuple[Part, ...]
    mileages: Mapping[int, float]  # by start, of the windows that have another one than is stored of them
    looked_at: Mapping[int, int]  # start and version of the due windows
    dropped: tuple[int, ...] = ()  # numbers of roll-ups without windows
    # whether some were made again, for there is more than windows behind all that were there before
    again: bool = False

    @property
    def due(self) -> bool:
        """Whether it is time to store it: else the windows wait, and are added again the next time."""
        return self.again or len(self.looked_at) >= WORK.rolled_together


def rolled(unit: UnitOfWork, rules: Membership) -> Rolled:
    """Return the roll-ups of a wheelset with everything that has happened to its windows since they were stored."""
    state, stored = unit.roll_ups.state(rules.wheelset), unit.roll_ups.of(rules.wheelset)
    due = unit.due.of_wheelset(DueStage.SUMS, rules.wheelset)
    if state is not None and _same_rules(state, rules):
        return _continued(unit, rules, state, stored, due)
    return _made_again(unit, rules, stored, due)


def read_ahead(unit: UnitOfWork, some: Sequence[Membership]) -> None:
    """Read together what :func:`rolled` asks for one wheelset after the other, of windows that are due."""
    looks = []
    new = {one.wheelset for one in some if unit.roll_ups.state(one.wheelset) is None}
    if sum(len(unit.due.of_wheelset(DueStage.SUMS, wheelset)) for wheelset in new) <= WORK.sums_in_memory:
        unit.tables.read_ahead(wheelsets=sorted(new))  # of these all are due
    for rules in some:
        due, state = unit.due.of_wheelset(DueStage.SUMS, rules.wheelset), unit.roll_ups.state(rules.wheelset)
        if state is not None and _same_rules(state, rules):
            sealed = [one for one in unit.roll_ups.of(rules.wheelset) if one.sealed]
            looks += [
                (rules.wheelset, next(starts), _Mileages(baseline, sealed))
                for baseline, starts in groupby(due, key=rules.baseline_of)
            ]
    unit.tables.read_ahead(readings=[(name, found.baseline.from_ns, at_ns) for name, at_ns, found in looks])
    unit.tables.read_ahead(
        spans=[
            (name, start_ns, found.baseline.to_ns, WORK.mileages_together)
            for name, start_ns, found in looks
            if found.before(unit, name, start_ns) is not None
        ]
    )


def read_sums_ahead(unit: UnitOfWork, by_wheelset: Sequence[tuple[str, Rolled]]) -> None:
    """Read the sums and tables of roll-ups that windows are added to together, if they are not many."""
    changed = [(name, part) for name, of_wheelset in by_wheelset for part in of_wheelset.parts if part.added]
    numbers = [p.roll_up.number for _, p in changed if p.roll_up.number is not None and not p.afresh]
    keys = [(name, member.start_ns) for name, part in changed for member in part.added]
    if len(numbers) <= WORK.sums_in_memory:
        chosen = {(name, at_ns) for name, part in changed for _, at_ns in part.roll_up.chosen}
        unit.roll_ups.read_ahead(numbers, sorted(chosen))
    if len(keys) <= WORK.sums_in_memory:
        unit.tables.read_ahead(keys=keys)


def _same_rules(state: RollUpState, rules: Membership) -> bool:
    classes = {vehicle: rules.table_key_and_class(vehicle) for vehicle in state.classes}
    return state.rules == rules.digest and state.classes == classes


def _state(rules: Membership, runs: Sequence[Run], before: Mapping[str, str]) -> RollUpState:
    vehicles = {window.record.vehicle for window, _ in runs}
    classes = {vehicle: rules.table_key_and_class(vehicle) for vehicle in vehicles}
    return RollUpState(rules.digest, {**before, **classes})


def _continued(
    unit: UnitOfWork, rules: Membership, state: RollUpState, stored: Sequence[RollUp], due: Mapping[int, int]
) -> Rolled:
    """Return the roll-ups with the due windows, and with those whose mileage these change."""
    runs = list(_changed(unit, rules, [roll_up for roll_up in stored if roll_up.sealed], due))
    mileages = {window.start_ns: mileage_km for window, mileage_km in runs}
    touched, new = sorted({*due, *mileages}), _members(rules, runs)
    again: dict[RollUpKey, list[Member]] = {}
    for roll_up in stored:
        before_last = roll_up.key in new and new[roll_up.key][0].start_ns <= roll_up.last_ns
        if not roll_up.sealed and (before_last or _is_touched(roll_up, touched)):
            again[roll_up.key] = _standing(unit, rules, roll_up, due.keys() | mileages.keys())
    parts = _summed({roll_up.key: Part(roll_up, before=roll_up.content) for roll_up in stored}, new, again)
    added_to_sealed = any(part.roll_up.sealed and part.added for part in parts)
    return Rolled(
        _state(rules, runs, state.classes),
        tuple(part for part in parts if part.roll_up.windows),
        mileages,
        due,
        dropped=tuple(p.roll_up.number for p in parts if p.roll_up.number is not None and not p.roll_up.windows),
        again=bool(again) or added_to_sealed or not due.keys() <= mileages.keys(),
    )


def _made_again(unit: UnitOfWork, rules: Membership, stored: Sequence[RollUp], due: Mapping[int, int]) -> Rolled:
    """Return the roll-ups by changed rules, from all tables that are there.

    Unchanged stay those that are sealed, and those of a former class or parameters whose windows are purged.
    """
    windows = unit.tables.tabled(rules.wheelset)
    purged = [window for window in windows if window.samples_purged]
    fixed = [one for one in stored if rules.assumed(one) is None and any(_is_in(one, window) for window in purged)]
    stay = {roll_up.number: roll_up for roll_up in (*fixed, *(old for old in stored if old.sealed))}
    sealed = [roll_up for roll_up in stay.values() if roll_up.sealed]
    held = _kept(list(stay.values()), rules)
    standing: set[int] = set()
    again: dict[RollUpKey, list[Member]] = {}
    for key, part in held.items():
        if not part.roll_up.sealed:
            kept_windows = [w for w in windows if _is_in(stay[part.roll_up.number], w) and w.start_ns not in due]
            again[key] = [rules.member(w, w.running_km, key) for w in kept_windows if w.running_km is not None]
            standing |= {window.start_ns for window in kept_windows}
    of_baselines = groupby(windows, key=lambda window: rules.baseline_of(window.start_ns))
    runs = [
        (window, mileage_km)
        for baseline, group in of_baselines
        for window, mileage_km, _ in _Mileages(baseline, sealed).of(list(group), None)
    ]
    for roll_up in stored:
        if roll_up.number not in stay and roll_up.key not in held:
            held[roll_up.key], again[roll_up.key] = Part(roll_up, before=roll_up.content), []
    parts = _summed(held, _members(rules, [run for run in runs if run[0].start_ns not in standing]), again)
    kept = {part.roll_up.number for part in parts if part.roll_up.windows}
    return Rolled(
        _state(rules, runs, {}),
        tuple(part for part in parts if part.roll_up.windows),
        {window.start_ns: mileage_km for window, mileage_km in runs if window.running_km != mileage_km},
        due,
        dropped=tuple(one.number for one in stored if one.number is not None and one.number not in kept),
        again=True,
    )


def _kept(stay: Sequence[RollUp], rules: Membership) -> dict[RollUpKey, Part]:
    """Return unchanged roll-ups by the key of their present place or, where that is taken, by a key of their own."""
    by_key: dict[RollUpKey, Part] = {}
    for roll_up in stay:
        table_key, place = _table_key(roll_up), rules.place_of(roll_up)
        key = None if place is None else RollUpKey(*place, table_key, roll_up.key.vehicle_class)
        if key is None or key in by_key:
            key = replace(roll_up.key, table_key=f"{table_key}{APART}{roll_up.number}")
        by_key[key] = Part(replace(roll_up, key=key), before=roll_up.content, moved=key != roll_up.key)
    return by_key


def _table_key(roll_up: RollUp) -> str:
    return roll_up.key.table_key.partition(APART)[0]


def _changed(unit: UnitOfWork, rules: Membership, sealed: Sequence[RollUp], due: Mapping[int, int]) -> Iterator[Run]:
    """Yield the windows that are due, or have another mileage than when they were looked at last, oldest first."""
    for baseline, starts in groupby(due, key=rules.baseline_of):
        mileages, from_ns = _Mileages(baseline, sealed), baseline.from_ns
        for start_ns in starts:
            if start_ns >= from_ns:
                from_ns = yield from _changed_from(unit, rules.wheelset, mileages, start_ns, due)


def _changed_from(
    unit: UnitOfWork, wheelset: str, mileages: _Mileages, start_ns: int, due: Mapping[int, int]
) -> Generator[Run, None, int]:
    """Yield the changed windows from a time on until those behind keep their mileage; return where that is."""
    baseline, at = mileages.baseline, mileages.before(unit, wheelset, start_ns)
    from_ns, limit = (baseline.from_ns, None) if at is None else (start_ns, WORK.mileages_together)
    rests = False
    while not rests:
        windows = unit.tables.tabled(wheelset, from_ns, baseline.to_ns, limit)
        for window, mileage_km, odometer in mileages.of(windows, at):
            same = window.running_km == mileage_km and window.start_ns not in due
            if not same:
                yield window, mileage_km
            if odometer is not at:
                at, rests = odometer, same  # the mileages behind it depend on this window alone
        rests = rests or len(windows) != limit
        from_ns = windows[-1].start_ns + 1 if windows else start_ns
    return max(from_ns, start_ns + 1)


class _Mileages:
    """The mileages of the windows of a baseline; where tables are gone they go on from the sealed roll-ups."""

    def __init__(self, baseline: Baseline, sealed: Iterable[RollUp]) -> None:
        self.baseline = baseline
        end_ns = math.inf if baseline.to_ns is None else baseline.to_ns
        of_baseline = (roll_up for roll_up in sealed if baseline.from_ns <= roll_up.last_ns < end_ns)
        self._sealed = sorted(of_baseline, key=lambda roll_up: roll_up.last_ns)
        self._ends = [roll_up.last_ns for roll_up in self._sealed]

    def before(self, unit: UnitOfWork, wheelset: str, start_ns: int) -> Odometer | None:
        """Return where the odometer stands before a time; None where there is no earlier reading."""
        last = unit.tables.last_reading(wheelset, self.baseline.from_ns, start_ns)
        at = None
        if last is not None and last.running_km is not None:
            at = Odometer(last.record.mileage_km, last.running_km, last.start_ns)
        return self._later(at, start_ns)

    def _later(self, at: Odometer | None, start_ns: int) -> Odometer | None:
        """Return where the odometer stands before a time, of what is given and the sealed roll-ups."""
        place = bisect_left(self._ends, start_ns)
        if not place or (at is not None and at.last_ns >= self._ends[place - 1]):
            return at
        sealed = self._sealed[place - 1]
        stored = known_mileage(sealed.last_stored_km)
        return Odometer(sealed.last_km if math.isnan(stored) else stored, sealed.last_km, sealed.last_ns)

    def of(
        self, windows: Sequence[TabledWindow], at: Odometer | None
    ) -> Iterator[tuple[TabledWindow, float, Odometer | None]]:
        """Yield windows, oldest first, with mileage and odometer behind them; without ``at`` all of the baseline."""
        for window in windows:
            record = window.record
            place = bisect_left(self._ends, record.start_ns)
            around = self._sealed[place] if place < len(self._ends) else None
            stored = known_mileage(record.mileage_km)
            if around is not None and around.first_ns <= record.start_ns and not math.isnan(stored):
                # by as much as the odometer was behind there; what is behind goes on from the end of the roll-up
                yield window, stored + (around.last_km - around.last_stored_km), at
                continue
            at = read(self._later(at, record.start_ns) or first_reading(one.record for one in windows), record)
            yield window, at.last_km, at


def _members(rules: Membership, runs: Iterable[Run]) -> dict[RollUpKey, list[Member]]:
    """Return windows by the key of their roll-up; those that belong to none are left out."""
    by_key: defaultdict[RollUpKey, list[Member]] = defaultdict(list)
    for window, mileage_km in runs:
        key = rules.key_of(window, mileage_km)
        if key is not None:
            by_key[key].append(rules.member(window, mileage_km, key))
    return dict(by_key)


def _is_touched(roll_up: RollUp, touched: Sequence[int]) -> bool:
    """Whether one of some times, increasing, is of the time of a roll-up."""
    place = bisect_left(touched, roll_up.first_ns)
    return place < len(touched) and touched[place] <= roll_up.last_ns


def _is_in(roll_up: RollUp, window: TabledWindow) -> bool:
    """Whether a window that has been looked at is in a roll-up: those of the same tables do not overlap in time."""
    return (
        roll_up.first_ns <= window.start_ns <= roll_up.last_ns
        and window.running_km is not None
        and window.parameter_key == _table_key(roll_up)
        and window.record.vehicle in roll_up.vehicles
    )


def _standing(unit: UnitOfWork, rules: Membership, roll_up: RollUp, touched: Collection[int]) -> list[Member]:
    """Return the windows that a stored roll-up has and keeps, oldest first."""
    windows = unit.tables.tabled(rules.wheelset, roll_up.first_ns, roll_up.last_ns + 1)
    return [
        rules.member(window, window.running_km, roll_up.key)
        for window in windows
        if window.running_km is not None and _is_in(roll_up, window) and window.start_ns not in touched
    ]


def _summed(
    held: Mapping[RollUpKey, Part],
    new: Mapping[RollUpKey, Sequence[Member]],
    again: Mapping[RollUpKey, Sequence[Member]],
) -> list[Part]:
    """Return the stored roll-ups with new windows, by key; those in ``again`` are summed again."""
    parts = []
    for key in sorted([*held, *(key for key in new if key not in held)]):
        part, added = held.get(key) or Part(RollUp(key), afresh=True), new.get(key, ())
        if key in again:
            parts.append(_of_members(part, sorted([*again[key], *added], key=lambda member: member.start_ns)))
        else:
            parts.append(replace(part, roll_up=with_members(part.roll_up, added), added=tuple(added)))
    return parts


def _of_members(part: Part, members: Sequence[Member]) -> Part:
    """Return a roll-up with just these windows; its stored sums count where they are those of the first of them."""
    whole, added = RollUp(part.roll_up.key, part.roll_up.number), tuple(members)
    afresh = True
    for count, member in enumerate(members, start=1):
        whole = with_members(whole, [member])
        if whole.content == part.before:
            added, afresh = tuple(members[count:]), False
    return replace(part, roll_up=whole, added=added, afresh=afresh)


def members(unit: UnitOfWork, rules: Membership, part: Part) -> list[Member]:
    """Return the windows of a roll-up that still have tables, oldest first."""
    added = {member.start_ns for member in part.added}
    before = [] if part.afresh else _standing(unit, rules, part.roll_up, added)
    return sorted([*before, *part.added], key=lambda member: member.start_ns)


def sums(unit: UnitOfWork, wheelset: str, part: Part) -> tuple[BinTable, BinTable]:
    """Return the sums of a roll-up's tables, plain and forgetting."""
    number = part.roll_up.number
    stored = None if part.afresh or number is None else unit.roll_ups.sums(number)
    if stored is not None and not part.added:
        return stored
    totals = None if stored is None else (TableSum(stored[0]), TableSum(stored[1]))
    weights = {member.start_ns: member.forgetting for member in part.added}
    for start_ns, cells in unit.tables.cells_of(wheelset, list(weights)):
        if totals is None:
            nothing = cells.table().without_samples
            totals = TableSum(nothing), TableSum(nothing)
        plain, forgetting = totals
        plain.add(cells)
        forgetting.add(cells, weights[start_ns])
    assert totals is not None  # a roll-up has windows
    return totals[0].table(), totals[1].table()
