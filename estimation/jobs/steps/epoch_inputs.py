"""What the windows of an epoch rest on besides their samples: what is on file of their wheelsets and vehicles."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field

from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import TreadwatchError
from estimation.jobs.settings import JobSettings
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.storage import UnitOfWork
from estimation.track.passes import Entry, ProfileLife, profile_life
from estimation.values.registry import Mounting, WheelsetRecord
from estimation.values.track import EpochMember, FoldState, TrackSectionRecord
from estimation.values.windows import WindowRecord


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
    _mountings: dict[str, Sequence[Mounting]] = field(default_factory=dict)
    _unmeasured: set[str] = field(default_factory=set)

    def look_up(self, records: Sequence[WindowRecord]) -> None:
        """Look up the wheelsets and vehicles of windows together."""
        serials = {record.wheelset for record in records} - self._mountings.keys()
        if not serials:
            return
        self.classes.look_up(sorted(serials), {record.vehicle for record in records})
        mountings = self.unit.registry.mountings_of(serials)
        self._mountings.update({serial: mountings.get(serial, ()) for serial in serials})
        self._unmeasured.update(serials - self.unit.registry.newest_measurement_of(serials).keys())

    def of(self, vehicle: str, wheelset: str) -> OnFile:
        """Return what is on file of a wheelset on a vehicle."""
        key = (vehicle, wheelset)
        if key not in self._known:
            self._known[key] = self._look_up(vehicle, wheelset)
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
        turned = any(_covers(one, record.start_ns) for one in found.mountings if one.reversed)
        text = f"{self.life(record)!r} {turned} {near!r} {record.axle} {found.assumed}"
        return EpochMember(record, found.digest, _digest(text))

    def _look_up(self, vehicle: str, wheelset: str) -> OnFile:
        mountings = self._mountings.get(wheelset)
        return OnFile(
            self.classes.wheelset(wheelset),
            self.unit.registry.mountings(wheelset) if mountings is None else mountings,
            () if wheelset in self._unmeasured else _measured(self.unit, wheelset),
            self.classes.digest(vehicle, wheelset),
        )


def _covers(mounting: Mounting, at_ns: int) -> bool:
    return mounting.from_ns <= at_ns and (mounting.to_ns is None or at_ns < mounting.to_ns)


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
    registered = unit.tracks.registered(section.code)
    layout = unit.tracks.layout_version(section.code)
    text = f"{section!r} {layout} {registered} {settings.alignment_parameters()!r}"
    return _digest(text), FoldState(registered, registered)


def input_digest(members: Sequence[EpochMember]) -> str:
    """Return a digest of the windows of an epoch and of what they are looked at with.

    Args:
        members: In any order.
    """
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
