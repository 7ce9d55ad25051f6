"""New windows of a wheelset are added to its roll-ups; what was replaced is taken away again.

Where a mileage or a rule has changed, so that windows belong elsewhere, all roll-ups whose tables are there are made
again. The answer is the same, bit for bit: the sums are exact.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby, pairwise

from estimation.jobs.steps.membership import Membership
from estimation.jobs.steps.running_mileage import known_mileage, plausible_step, running
from estimation.storage import UnitOfWork
from estimation.tables import bin_table
from estimation.tables.bin_table import bin_parameters
from estimation.tables.exact_sum import ExactSum, nothing
from estimation.values.geometry import FilledCells
from estimation.values.roll_up import (
    ExactTable,
    Member,
    Odometer,
    RollUp,
    RollUpKey,
    RollUpState,
    TabledWindow,
    TakenTable,
    of_members,
    with_member,
)

APART = " of "  # behind the key of its tables, the number of a roll-up that belongs to no key by the present rules
KEPT_WAITING = 32  # windows that are added again each time before they are rolled: sums are written once for so many


@dataclass(frozen=True, slots=True)
class Part:
    """A roll-up with what is to be added to its stored sums, and to be taken away from them."""

    roll_up: RollUp
    added: tuple[Member, ...] = ()
    taken: tuple[TakenTable, ...] = ()
    afresh: bool = False  # the stored sums do not count
    moved: bool = False  # its key is another
    before: str = ""  # digest of the content that is stored


@dataclass(frozen=True, slots=True)
class Rolled:
    """The roll-ups of a wheelset as they should be, beside what is stored."""

    state: RollUpState
    parts: tuple[Part, ...]
    outside: tuple[TabledWindow, ...] = ()  # looked at, and of no roll-up
    taken: tuple[int, ...] = ()  # numbers of the tables taken away
    dropped: tuple[int, ...] = ()  # numbers of roll-ups without windows
    again: bool = False  # all were made again

    @property
    def due(self) -> bool:
        """Whether it is time to store it: else the windows wait, and are added again the next time."""
        fresh = sum(len(part.added) for part in self.parts) + len(self.outside)
        return self.again or bool(self.taken) or fresh >= KEPT_WAITING


@dataclass(slots=True)
class _Open:
    """Roll-ups while windows are added."""

    rules: Membership
    parts: dict[RollUpKey, Part] = field(default_factory=dict)
    outside: list[TabledWindow] = field(default_factory=list)

    def add(self, window: TabledWindow, mileage_km: float) -> None:
        key = self.rules.key_of(window, mileage_km)
        if key is None:
            self.outside.append(window)
            return
        member = self.rules.member(window, mileage_km, key)
        part = self.parts.get(key) or Part(RollUp(key), afresh=True)
        self.parts[key] = replace(part, added=(*part.added, member))

    def closed(self) -> tuple[Part, ...]:
        """Return the roll-ups with what was added counted, in the order of their keys."""
        return tuple(_counted(self.parts[key]) for key in sorted(self.parts))


def _counted(part: Part) -> Part:
    roll_up = part.roll_up
    for member in part.added:
        roll_up = with_member(roll_up, member)
    return replace(part, roll_up=roll_up)


def rolled(unit: UnitOfWork, rules: Membership) -> Rolled:
    """Return the roll-ups of a wheelset with everything that has happened to its windows since they were stored."""
    state, stored = unit.roll_ups.state(rules.wheelset), unit.roll_ups.of(rules.wheelset)
    if state is not None and _same_rules(state, rules):
        found = _continued(unit, rules, state, stored)
        if found is not None:
            return found
    return _made_again(unit, rules, stored)


def _same_rules(state: RollUpState, rules: Membership) -> bool:
    known = {vehicle: rules.class_of(vehicle) for vehicle in state.classes}
    return state.rules == rules.digest and state.classes == known


def _classes(rules: Membership, vehicles: Iterator[str], before: Mapping[str, str] | None = None) -> dict[str, str]:
    return {**(before or {}), **{vehicle: rules.class_of(vehicle) for vehicle in set(vehicles)}}


def _made_again(unit: UnitOfWork, rules: Membership, stored: Sequence[RollUp]) -> Rolled:
    """Return the roll-ups from all tables that are there, beside those that stay as they are.

    These are sealed, or of a former class or parameters and with windows that cannot be estimated again.
    """
    windows = unit.tables.tabled(rules.wheelset)
    fixed = {one.roll_up for one in windows if one.rolled and one.samples_purged}
    stay = {one.number: one for one in stored if one.sealed or (one.number in fixed and rules.assumed(one) is None)}
    at = _Open(rules, _kept(list(stay.values()), rules))
    odometers: dict[int, Odometer] = {}
    for number, group in _by_baseline(windows, rules).items():
        before = [one for one in stay.values() if rules.baseline_of(one.last_ns).number == number]
        for window, mileage_km, odometer in _chained(group, before):
            odometers[number] = odometer
            if not (window.rolled and window.roll_up in stay):
                at.add(window, mileage_km)
    for one in sorted(stay.values(), key=lambda one: one.last_ns):
        number = rules.baseline_of(one.last_ns).number
        if number not in odometers or odometers[number].seen_ns < one.last_ns:
            odometers[number] = _after(one)
    all_taken = unit.roll_ups.taken(rules.wheelset)
    taken = [one for one in all_taken if one.roll_up in stay]
    by_key = {one.key: one for one in stored}
    parts = [_in_place_of(by_key.get(part.roll_up.key), part) for part in _taken_away(unit, rules, at.closed(), taken)]
    kept = {part.roll_up.number for part in parts}
    return Rolled(
        RollUpState(rules.digest, _classes(rules, (one.record.vehicle for one in windows)), odometers),
        tuple(parts),
        tuple(at.outside),
        tuple(one.number for one in all_taken),
        tuple(one.number for one in stored if one.number is not None and one.number not in kept),
        again=True,
    )


def _in_place_of(stored: RollUp | None, part: Part) -> Part:
    """Return a roll-up that was made again under the number of the one that is stored."""
    if stored is None or part.roll_up.number is not None:
        return part
    return replace(part, roll_up=replace(part.roll_up, number=stored.number), before=stored.content_digest)


def _kept(stay: Sequence[RollUp], rules: Membership) -> dict[RollUpKey, Part]:
    """Return roll-ups that stay as they are by the key of their place now; where that is taken, by one of their own."""
    found: dict[RollUpKey, Part] = {}
    for one in stay:
        table_key, place = one.key.table_key.partition(APART)[0], rules.place_of(one)
        key = None if place is None else RollUpKey(*place, table_key, one.key.vehicle_class)
        if key is None or key in found:
            key = replace(one.key, table_key=f"{table_key}{APART}{one.number}")
        found[key] = Part(replace(one, key=key), before=one.content_digest, moved=key != one.key)
    return found


def _chained(windows: Sequence[TabledWindow], stay: Sequence[RollUp]) -> Iterator[tuple[TabledWindow, float, Odometer]]:
    """Yield windows of a baseline with mileage and odometer; the chain goes on from roll-ups whose tables are gone."""
    odometer: Odometer | None = None

    def last_before(window: TabledWindow) -> RollUp | None:
        before = [one for one in stay if one.sealed and one.last_ns < window.record.start_ns]
        return max(before, key=lambda one: one.last_ns, default=None)

    for last, group in groupby(windows, key=last_before):
        found = list(group)
        odometer = odometer if last is None else _after(last)
        for window, (mileage_km, at) in zip(found, running([one.record for one in found], odometer), strict=True):
            odometer = at
            yield window, mileage_km, at


def _after(last: RollUp) -> Odometer:
    """Return where the chain stands after the last window of a roll-up."""
    return Odometer(last.last_km - last.last_stored_km, last.last_stored_km, last.last_km, last.last_ns, last.last_ns)


def _by_baseline(windows: Sequence[TabledWindow], rules: Membership) -> dict[int, list[TabledWindow]]:
    found: defaultdict[int, list[TabledWindow]] = defaultdict(list)
    for window in sorted(windows, key=lambda one: one.record.start_ns):
        found[rules.baseline_of(window.record.start_ns).number].append(window)
    return found


def _continued(unit: UnitOfWork, rules: Membership, state: RollUpState, stored: Sequence[RollUp]) -> Rolled | None:
    """Return the roll-ups with what waits; None where that changes the mileage of other windows."""
    waiting, taken = unit.tables.waiting(rules.wheelset), unit.roll_ups.taken(rules.wheelset)
    at = _Open(rules, {one.key: Part(one, before=one.content_digest) for one in stored})
    odometers = dict(state.odometers)
    gone = {one.start_ns for one in taken} - {one.record.start_ns for one in waiting}
    if not all(_fits(unit, rules, start_ns) for start_ns in gone):
        return None
    groups = _by_baseline(waiting, rules)
    for number in {rules.baseline_of(one.start_ns).number for one in taken} | set(groups):
        group, before = groups.get(number, []), odometers.get(number)
        late = [one for one in group if before is not None and one.record.start_ns <= before.seen_ns]
        if not all(_fits(unit, rules, one.record.start_ns) for one in late):
            return None
        if before is not None and any(one.start_ns == before.seen_ns for one in taken):
            before = _chain_end(unit, rules, before.seen_ns)
            odometers.pop(number)
            if before is not None:
                odometers[number] = before
        sealed = [part.roll_up for part in at.parts.values() if part.roll_up.sealed]
        for window in late:
            at.add(window, window.record.mileage_km + _shift(sealed, window))
        chain = running([one.record for one in group[len(late) :]], before)
        for window, (mileage_km, odometer) in zip(group[len(late) :], chain, strict=True):
            at.add(window, mileage_km)
            odometers[number] = odometer
    parts = _taken_away(unit, rules, at.closed(), taken)
    return Rolled(
        RollUpState(rules.digest, _classes(rules, (one.record.vehicle for one in waiting), state.classes), odometers),
        tuple(part for part in parts if part.roll_up.windows),
        tuple(at.outside),
        tuple(one.number for one in taken),
        tuple(p.roll_up.number for p in parts if p.roll_up.number is not None and not p.roll_up.windows),
    )


def _shift(sealed: Sequence[RollUp], window: TabledWindow) -> float:
    """Return by how many km the odometer was behind in the roll-up without tables that a late window falls into."""
    around = [one for one in sealed if one.first_ns <= window.record.start_ns <= one.last_ns]
    return around[0].last_km - around[0].last_stored_km if around else 0.0


def _fits(unit: UnitOfWork, rules: Membership, start_ns: int) -> bool:
    """Whether the windows beside and at a time have their stored mileage, each a plausible step after the other."""
    beside = _beside(unit, rules, start_ns)
    plain = all(one.running_km in (None, one.record.mileage_km) for one in beside)
    known = all(known_mileage(one.record.mileage_km) == one.record.mileage_km for one in beside)
    steps = pairwise(one.record for one in beside)
    return plain and known and all(plausible_step(first, second) for first, second in steps)


def _chain_end(unit: UnitOfWork, rules: Membership, seen_ns: int) -> Odometer | None:
    """Return where the chain ends when the window at its end is another one, or gone; None where it was the only one.

    The windows beside it fit.
    """
    until = [one.record for one in _beside(unit, rules, seen_ns) if one.record.start_ns <= seen_ns]
    if not until:
        return None
    last = until[-1]
    return Odometer(0.0, last.mileage_km, last.mileage_km, last.start_ns, last.start_ns)


def _beside(unit: UnitOfWork, rules: Membership, start_ns: int) -> Sequence[TabledWindow]:
    baseline = rules.baseline_of(start_ns)
    return unit.tables.beside(rules.wheelset, start_ns, baseline.from_ns, baseline.to_ns)


def _taken_away(unit: UnitOfWork, rules: Membership, parts: Sequence[Part], taken: Sequence[TakenTable]) -> list[Part]:
    """Return the roll-ups without the tables that were replaced or removed."""
    of_number: defaultdict[int | None, list[TakenTable]] = defaultdict(list)
    for one in taken:
        of_number[one.roll_up].append(one)
    return [
        _without(unit, rules, part, of_number[part.roll_up.number]) if part.roll_up.number in of_number else part
        for part in parts
    ]


def _without(unit: UnitOfWork, rules: Membership, part: Part, taken: Sequence[TakenTable]) -> Part:
    roll_up = part.roll_up
    if not roll_up.sealed:
        return replace(part, roll_up=of_members(roll_up, members(unit, rules, part)), taken=tuple(taken))
    for one in taken:
        weight = round(rules.forgetting(roll_up.key, one.mileage_km) * 2**40)
        mileage_mm = round(one.mileage_km * 1e6)
        roll_up = replace(
            roll_up,
            windows=roll_up.windows - 1,
            content=(roll_up.content - int(one.line, 16)) % 2**256,
            mileage_mm=roll_up.mileage_mm - mileage_mm,
            weight=roll_up.weight - weight,
            weighted_mileage=roll_up.weighted_mileage - weight * mileage_mm,
        )
    return replace(part, roll_up=roll_up, taken=tuple(taken))


def members(unit: UnitOfWork, rules: Membership, part: Part) -> list[Member]:
    """Return the windows of a roll-up that still have tables, oldest first."""
    key, number = part.roll_up.key, part.roll_up.number
    rolled_before = [] if number is None or part.afresh else unit.tables.of_roll_up(rules.wheelset, number)
    before = [rules.member(one, one.running_km, key) for one in rolled_before if one.running_km is not None]
    return sorted([*before, *part.added], key=lambda one: one.start_ns)


def sums(unit: UnitOfWork, rules: Membership, part: Part) -> tuple[ExactTable, ExactTable] | None:
    """Return the sums of a roll-up's tables, plain and forgetting; None where its class is another by now.

    Args:
        unit: Sums and tables are read, one table at a time.
    """
    roll_up = part.roll_up
    stored = None if part.afresh or roll_up.number is None else unit.roll_ups.sums(roll_up.number)
    if stored is None:
        assumed = rules.assumed(roll_up)
        if assumed is None:
            return None
        parameters = bin_parameters(assumed.windows)
        stored = (nothing(bin_table.init(parameters), parameters),) * 2
    if not part.added and not part.taken:
        return stored
    plain, weighted = map(ExactSum, stored)

    def put(cells: FilledCells, weight: float, change: Callable[[ExactSum, FilledCells, float], None]) -> None:
        change(plain, cells, 1.0)
        change(weighted, cells, weight)

    for one in part.taken:
        put(one.cells, rules.forgetting(roll_up.key, one.mileage_km), ExactSum.take)
    weights = {one.start_ns: one.forgetting for one in part.added}
    for start_ns, cells in unit.tables.cells_of(rules.wheelset, sorted(weights)):
        put(cells, weights[start_ns], ExactSum.add)
    return plain.result(), weighted.result()
