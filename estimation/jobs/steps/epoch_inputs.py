"""Which epoch of a section is due, and what its windows rest on besides their samples: what is on file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import takewhile

from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import TreadwatchError
from estimation.jobs.job import JobContext
from estimation.jobs.parameters import JOBS, WORK
from estimation.jobs.settings import JobSettings
from estimation.jobs.steps.assumptions import ClassLookup
from estimation.storage import UnitOfWork
from estimation.track.passes import Entry, Group, ProfileLife, first_epoch, profile_life
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.track import EpochMember, FoldState, ListedWindow, TrackEpoch, TrackSectionRecord
from estimation.values.units import LATEST_NS, SECOND_NS
from estimation.values.windows import WindowKey, WindowRecord


@dataclass(frozen=True, slots=True)
class OnFile:
    """What is on file of a wheelset on a vehicle."""

    wheelset: WheelsetRecord
    mountings: Sequence[Mounting]
    measured: Sequence[tuple[int, float, str]]  # time, mileage and digest of each measurement of its profiles
    assumed: str  # digest of what its windows are looked at with

    @property
    def digest(self) -> str:
        """Digest of all of it."""
        turned = [(item.at_ns, item.mileage_km) for item in self.wheelset.reprofilings]
        reversals = [(item.from_ns, item.to_ns) for item in self.mountings if item.reversed]
        return _digest(f"{turned!r} {reversals!r} {list(self.measured)!r} {self.assumed}")


@dataclass(frozen=True, slots=True)
class FileLookup:
    """What is on file of wheelsets on vehicles as one transaction sees it; each is looked up once."""

    unit: UnitOfWork
    settings: JobSettings
    classes: ClassLookup
    _known: dict[tuple[str, str], OnFile] = field(default_factory=dict)

    def look_up(self, records: Sequence[WindowRecord]) -> None:
        """Look up the wheelsets and vehicles of windows together."""
        serials = sorted({record.wheelset for record in records})
        self.classes.look_up(serials, {record.vehicle for record in records})
        self.unit.registry.mountings_of(serials)
        self.unit.registry.newest_measurement_of(serials)

    def of(self, vehicle: str, wheelset: str) -> OnFile:
        """Return what is on file of a wheelset on a vehicle."""
        key, registry = (vehicle, wheelset), self.unit.registry
        if key not in self._known:
            self._known[key] = OnFile(
                self.classes.wheelset(wheelset),
                registry.mountings(wheelset),
                _measured(self.unit, wheelset) if registry.newest_measurement_of([wheelset]) else (),
                self.classes.digest(vehicle, wheelset),
            )
        return self._known[key]

    def life(self, record: WindowRecord) -> ProfileLife:
        """Return the life of the profile in a window."""
        wheelset = self.of(record.vehicle, record.wheelset).wheelset
        return profile_life(wheelset, record, self.settings.estimation.interval_km)

    def member(self, record: WindowRecord) -> EpochMember:
        """Return a window with digests of what is on file and of what of it concerns the window."""
        found = self.of(record.vehicle, record.wheelset)
        near = [
            digest
            for _, mileage_km, digest in found.measured
            if abs(mileage_km - record.mileage_km) <= self.settings.alignment.measured_km
        ]
        turned = any(mounting.covers(record.start_ns) for mounting in found.mountings if mounting.reversed)
        text = f"{self.life(record)!r} {turned} {near!r} {record.axle} {found.assumed}"
        return EpochMember(record, found.digest, _digest(text))


def _measured(unit: UnitOfWork, wheelset: str) -> Sequence[tuple[int, float, str]]:
    try:
        found = unit.registry.measured_profiles(wheelset)
    except TreadwatchError as error:  # one that cannot be read is reported by the epoch
        return [(0, 0.0, _digest(str(error)))]
    return [(item.at_ns, item.mileage_km, _profiles_digest(item)) for item in found]


def _profiles_digest(item: MeasuredProfiles) -> str:
    text = hashlib.sha256(f"{item.mileage_km!r} {item.std!r}\n".encode())
    for profile in (item.left, item.right):
        text.update(profile.y.tobytes() + profile.z.tobytes())
    return text.hexdigest()


def given(unit: UnitOfWork, section: TrackSectionRecord, settings: JobSettings) -> tuple[str, FoldState]:
    """Return a digest of what all epochs of a section rest on, and what is known of it before the first."""
    registered, layout = unit.tracks.given(section.code)
    text = f"{section!r} {layout} {registered} {settings.alignment_parameters()!r}"
    return _digest(text), FoldState(registered, registered)


def input_digest(members: Sequence[EpochMember]) -> str:
    """Return a digest of the windows of an epoch and of what they are looked at with."""
    text = hashlib.sha256()
    for member in sorted(members, key=lambda one: (one.record.wheelset, one.record.start_ns)):
        record = member.record
        line = f"{record.wheelset} {record.start_ns} {record.content_digest} {record.mileage_km!r} {member.assumed}\n"
        text.update(line.encode())
    return text.hexdigest()


def entries(lookup: FileLookup, records: Sequence[WindowRecord]) -> list[Entry]:
    """Return windows with the lives of their profiles."""
    return [(record, lookup.life(record)) for record in records]


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True, slots=True)
class Due:
    """An epoch that has to be looked at, with the epochs as they were read.

    Without windows of its own it and those behind it have none left.
    """

    section: TrackSectionRecord
    number: int
    stored: Sequence[TrackEpoch]
    before: FoldState
    basis: str  # digest of what all epochs rest on
    own: Sequence[EpochMember] = ()
    entries: Sequence[Entry] = ()  # its own windows and those that wait
    digest: str = ""
    horizon_ns: int = 0

    @property
    def old(self) -> TrackEpoch | None:
        """The epoch as it was computed last."""
        return self.stored[self.number - 1] if self.number <= len(self.stored) else None

    @property
    def rests(self) -> bool:
        """Whether the epoch is there and rests on what it did."""
        old = self.old
        if old is None or old.stale:
            return False
        return old.before == self.before.key(self.basis) and old.input_digest == self.digest


@dataclass(frozen=True, slots=True)
class Kept:
    """An epoch that rests on what it did, though windows about it have changed, as it is to be stored."""

    epoch: TrackEpoch
    own: Sequence[EpochMember]


@dataclass(frozen=True, slots=True)
class Found:
    """What a look at the epochs of a section has found."""

    stored: Sequence[TrackEpoch]  # all epochs, as they were read
    kept: Sequence[Kept] = ()  # epochs before the one that is due, or left for later
    due: Due | None = None  # the first to be computed; None where all others are as they should be
    # whether the last epoch stays as it is for now: a later run looks at it although nothing has changed
    later: bool = False

    @property
    def last(self) -> bool:
        """Whether the epoch that is due holds all windows that are left, and none is stored behind it."""
        due = self.due
        return due is not None and due.number >= len(self.stored) and due.horizon_ns == LATEST_NS


@dataclass(frozen=True, slots=True)
class EpochSearch:
    """The epochs of a section as one transaction sees them."""

    unit: UnitOfWork
    context: JobContext
    section: TrackSectionRecord
    lookup: FileLookup
    stored: Sequence[TrackEpoch]  # all epochs, in order
    changed_ns: int | None  # start of the first window that they do not hold as it is now; None where there is none

    def found(self) -> Found:
        """Return what is due."""
        stored = self.stored
        basis, first = given(self.unit, self.section, self.context.settings)
        states = [first, *(epoch.after for epoch in stored)]
        kept: list[Kept] = []

        def due_of(number: int) -> tuple[Due, Group | None]:
            due = Due(self.section, number, stored, states[number - 1], basis)
            return self._with_windows(due, {member.record.key for one in kept for member in one.own})

        for epoch in stored:
            reached = self.changed_ns is not None and self.changed_ns <= epoch.horizon_ns
            if not (epoch.stale or epoch.before != states[epoch.number - 1].key(basis) or reached):
                continue
            due, group = due_of(epoch.number)
            if group is not None and epoch.number == len(stored) and self._leaves_for_later(due, group):
                return Found(stored, kept, later=True)
            if group is None or not due.rests:
                return Found(stored, kept, due)
            kept.append(Kept(replace(epoch, horizon_ns=group.horizon_ns, windows=len(due.own)), due.own))
        due, group = due_of(len(stored) + 1)
        return Found(stored, kept, None if group is None else due)

    def _with_windows(self, due: Due, taken: Collection[WindowKey]) -> tuple[Due, Group | None]:
        """Return an epoch with its windows; without any where none are left."""
        settings, code = self.context.settings.alignment, self.section.code
        limit = WORK.epoch_read_factor * settings.most_windows + len(taken)
        left = [one for one in self.unit.epochs.remaining(code, due.number, limit) if one.key not in taken]
        if not left:
            return due, None
        self.lookup.look_up(left)
        group = first_epoch(
            entries(self.lookup, left), settings.most_windows, settings.most_wheelsets, settings.partition
        )
        # those right before it that have identified nothing
        before = [one.number for one in takewhile(lambda one: one.waits, reversed(due.stored[: due.number - 1]))]
        waiting = self.unit.epochs.windows(code, before) if before else ()
        self.lookup.look_up(waiting)
        own = [self.lookup.member(record) for record, _ in group.entries]
        members = [*(self.lookup.member(record) for record in waiting), *own]
        whole = replace(
            due,
            own=own,
            entries=[*entries(self.lookup, waiting), *group.entries],
            digest=input_digest(members),
            horizon_ns=group.horizon_ns,
        )
        return whole, group

    def _leaves_for_later(self, due: Due, group: Group) -> bool:
        """Return whether the last epoch stays as it is for now: windows still come, and it has hardly grown since.

        It is computed by the first run that finds no new window, so what is stored at rest is the same.
        """
        old, context = due.old, self.context
        assert old is not None
        ages_ns = [context.clock.now_ns() - record.recorded_ns for record, _ in group.entries]
        coming = any(0 <= age_ns < context.quiet_s * SECOND_NS for age_ns in ages_ns)
        grows = old.windows < len(group.entries) < JOBS.growth_factor * old.windows
        return coming and grows and group.horizon_ns == LATEST_NS and old.before == due.before.key(due.basis)


def changed_from(unit: UnitOfWork, lookup: FileLookup, section: str) -> int | None:
    """Return the start of the first window of a section that is listed and that no epoch holds as it is now.

    What comes so late that samples of later windows have been purged joins the next epoch, and none is computed again
    for it.
    """
    purged_ns: list[int | None] = []

    def in_time(listed: ListedWindow) -> bool:
        if not purged_ns:
            purged_ns.append(unit.epochs.purged_until(section))
        return purged_ns[0] is None or listed.start_ns > purged_ns[0]

    for listed in unit.epochs.listed(section):
        if _has_come(listed, section, in_time):
            return listed.start_ns
        record, held = listed.record, listed.held
        if record is None or held is None or held.section != section:
            continue
        if lookup.member(record).assumed != held.assumed:  # what is on file changes how it is looked at
            return listed.start_ns
    return None


def _has_come(listed: ListedWindow, section: str, in_time: Callable[[ListedWindow], bool]) -> bool:
    """Return whether a window is new on a section, or has changed."""
    record, held = listed.record, listed.held
    if record is None or record.track_section != section or record.samples_purged:
        return False
    if held is None:
        return in_time(listed)
    now = (record.track_section, record.vehicle, record.content_digest, record.mileage_km)
    return now != (held.section, held.vehicle, held.content_digest, held.mileage_km)


def otherwise_on_file(
    unit: UnitOfWork, lookup: FileLookup, section: str
) -> tuple[Mapping[WindowKey, int], Sequence[tuple[str, str, str]]]:
    """Return for which windows of a section something else is on file than when their epoch was computed.

    Returns:
        Their starts by key, and vehicle, wheelset and digest of what is on file now where it changes nothing for them.
    """
    changed: dict[WindowKey, int] = {}
    unaffected: list[tuple[str, str, str]] = []
    for vehicle, wheelset, digest in unit.epochs.contexts(section):
        now = lookup.of(vehicle, wheelset).digest
        if now == digest:
            continue
        held = unit.epochs.members(section, vehicle, wheelset)
        other = [one.record for one in held if lookup.member(one.record).assumed != one.assumed]
        changed |= {record.key: record.start_ns for record in other}
        if not other:
            unaffected.append((vehicle, wheelset, now))
    return changed, unaffected
