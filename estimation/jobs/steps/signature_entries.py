"""What the fleet knows of the wheelsets whose signatures are stored: library entries, and why others are none."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from estimation.accuracy.wheel_contact import AMPLITUDES, RailShare, WheelPair, wheel_contact
from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import DamagedError
from estimation.jobs.parameters import JOBS
from estimation.jobs.steps.assumptions import Baseline, ClassLookup, baselines, with_identity_alerts
from estimation.signatures.window_signatures import SignatureParameters
from estimation.storage import UnitOfWork
from estimation.trend.extrapolation import LIMIT_AMPLITUDE, SAME_AMPLITUDE, extrapolated
from estimation.values.geometry import KnownConicity, interval_conicities
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import WheelsetRecord
from estimation.values.signatures import ConicitySource, DesignPair, KnownSignatures, LibraryEntry, Place
from estimation.values.track import TrackSectionRecord

AT_LIMIT = int(abs(AMPLITUDES - LIMIT_AMPLITUDE).argmin())


@dataclass(frozen=True, slots=True)
class _Label:
    mileage_km: float
    conicity: float
    std: float

    def at(self, mileage_km: float) -> tuple[float, float]:
        """Return conicity and std at another mileage, whose wear is not known."""
        return self.conicity, float(np.hypot(self.std, JOBS.conicity_wear_per_km * (mileage_km - self.mileage_km)))


@dataclass(frozen=True, slots=True)
class Entries:
    """Library entries of all classes, by key, and how many windows give none, by reason.

    ``damaged`` has the wheelsets of which something that is stored cannot be read.
    """

    found: tuple[LibraryEntry, ...]
    left_out: Mapping[ReasonCode, int]
    damaged: Mapping[str, DamagedError]


@dataclass(frozen=True, slots=True)
class EntryReader:
    """Reads what the fleet knows of wheelsets, in one transaction."""

    unit: UnitOfWork
    classes: ClassLookup
    parameters: SignatureParameters  # how old and how uncertain a conicity may be
    _sections: dict[str, TrackSectionRecord] = field(default_factory=dict)
    _baselines: dict[str, Sequence[Baseline]] = field(default_factory=dict)
    _labels: dict[tuple[str, int], Sequence[_Label]] = field(default_factory=dict)
    _damaged: dict[str, DamagedError] = field(default_factory=dict)
    _contacts: dict[tuple[str, int, RailShare], tuple[float, float] | None] = field(default_factory=dict)

    def read_ahead(self, signatures: Sequence[KnownSignatures], others: Iterable[str]) -> None:
        """Read together what is asked for one wheelset after the other; where something is damaged, that one fails."""
        serials = sorted({window.found.wheelset for window in signatures}.union(others))
        self.classes.look_up(serials, {window.found.vehicle for window in signatures})
        self.unit.registry.mountings_of(serials)
        for read in (self.unit.registry.measured_profiles_of, self.unit.geometries.read_ahead):
            with suppress(DamagedError):
                read(serials)

    def entries(self, signatures: Sequence[KnownSignatures]) -> Entries:
        """Return the library entries that signatures make, the newest of each wheelset, place and band of speed."""
        doubted, left_out = frozenset(with_identity_alerts(self.unit)), Counter[ReasonCode]()
        newest: dict[tuple[str, int, Place, int], LibraryEntry] = {}
        for window in signatures:
            wheelset = window.found.wheelset
            entries = ReasonCode.IDENTITY_DOUBTFUL if wheelset in doubted else self._taught(window)
            if isinstance(entries, ReasonCode):
                left_out[entries] += 1
                continue
            for entry in entries:
                place = entry.signature.place
                if place is not None:
                    newest[
                        wheelset, entry.baseline, place, int(entry.signature.speed // self.parameters.speed_band)
                    ] = entry
        return Entries(tuple(newest.values()), left_out, dict(self._damaged))

    def _taught(self, window: KnownSignatures) -> list[LibraryEntry] | ReasonCode:
        """Return the entries that a window makes, or why it makes none; what is damaged takes out its wheelset."""
        wheelset = window.found.wheelset
        if wheelset in self._damaged:
            return ReasonCode.FILE_DAMAGED
        try:
            baseline, section = self.baseline_at(wheelset, window.found.start_ns).number, self._section(window)
            label = None if section is None else self._label(window, baseline, section)
        except DamagedError as error:
            self._damaged[wheelset] = error
            return ReasonCode.FILE_DAMAGED
        if label is None or isinstance(label, ReasonCode):
            return label or ReasonCode.SECTION_UNKNOWN
        conicity, std, source = label
        shared, pair = self.sharing(window), self.pair(window)
        return [LibraryEntry(item, baseline, conicity, std, source, shared, pair) for item in window.found.signatures]

    def baseline_at(self, wheelset: str, at_ns: int) -> Baseline:
        """Return the life of a wheelset's profile at a time."""
        return next(life for life in reversed(self.lives(wheelset)) if life.from_ns <= max(at_ns, 0))

    def lives(self, wheelset: str) -> Sequence[Baseline]:
        """Return the lives of a wheelset's profile, oldest first."""
        if wheelset not in self._baselines:
            self._baselines[wheelset] = baselines(self.classes.wheelset(wheelset))
        return self._baselines[wheelset]

    def sharing(self, window: KnownSignatures) -> tuple[str, ...]:
        """Return the wheelsets whose samples are in a window's signatures: its own, and the other of its bogie."""
        wheelset, vehicle, start_ns = window.found.wheelset, window.found.vehicle, window.found.start_ns
        on_file = self.classes.of_vehicle(vehicle)
        there = (m for m in self.unit.registry.mountings(wheelset) if m.vehicle == vehicle)
        mounting = next((mounting for mounting in there if mounting.covers(start_ns)), None)
        if isinstance(on_file, Reason) or mounting is None:
            return (wheelset,)
        partner = on_file.vehicle_class.partner(mounting.axle)
        other = None if partner is None else self.unit.registry.mounting_at(vehicle, partner, start_ns)
        return (wheelset,) if other is None else (wheelset, other.wheelset)

    def pair(self, window: KnownSignatures) -> DesignPair:
        """Return the design profiles of wheels and rails that a window ran on."""
        section = self._section(window)
        rail = None if section is None else f"{section.rail_profile} {section.rail_inclination:.6f}"
        return DesignPair(self.classes.wheelset(window.found.wheelset).wheel_profile, rail)

    def _section(self, window: KnownSignatures) -> TrackSectionRecord | None:
        place = window.found.signatures[0].place
        if place is None:
            return None
        if not self._sections:
            self._sections.update({section.code: section for section in self.unit.tracks.sections()})
        return self._sections.get(place.section)

    def _label(
        self, window: KnownSignatures, baseline: int, section: TrackSectionRecord
    ) -> tuple[float, float, ConicitySource] | ReasonCode:
        """Return conicity, std and source; or why it is not known well enough."""
        measured, turned = self._of_measurement(window, baseline, section)
        if measured is not None:
            return (*measured, ConicitySource.MEASURED_PROFILES)
        far_km = self.parameters.most_mileage_km
        labels = self._estimates(window.found.wheelset, baseline)
        near = [label.at(window.mileage_km) for label in labels if abs(label.mileage_km - window.mileage_km) <= far_km]
        best = min(near, key=lambda label: label[1], default=None)
        if best is not None and best[1] <= self.parameters.most_std:
            return (*best, ConicitySource.GEOMETRY)
        return ReasonCode.WHEELSET_TURNED if turned else ReasonCode.NO_CONICITY

    def _of_measurement(
        self, window: KnownSignatures, baseline: int, section: TrackSectionRecord
    ) -> tuple[tuple[float, float] | None, bool]:
        """Return conicity and std by the nearest measurement of the same profile; and whether one is of another."""
        wheelset = window.found.wheelset
        measured, far_km = self.unit.registry.measured_profiles(wheelset), self.parameters.most_mileage_km
        near = [item for item in measured if abs(item.mileage_km - window.mileage_km) <= far_km]
        same = [item for item in near if self.baseline_at(wheelset, item.at_ns).number == baseline]
        rails = RailShare.of(section)
        for item in sorted(same, key=lambda item: abs(item.mileage_km - window.mileage_km)):
            contact = self._contact(item, self.classes.wheelset(wheelset), rails)
            if contact is not None:
                return _Label(item.mileage_km, *contact).at(window.mileage_km), False
        return None, len(near) > len(same)

    def _contact(
        self, item: MeasuredProfiles, wheelset: WheelsetRecord, rails: RailShare
    ) -> tuple[float, float] | None:
        key = (item.wheelset, item.at_ns, rails)
        if key not in self._contacts:
            pair = WheelPair(item.left, item.right, wheelset.nominal_radius_m, item.std)
            contact = wheel_contact(pair, [rails])
            conicity = None if isinstance(contact, Reason) else contact.conicity[AT_LIMIT]
            usable = None
            if conicity is not None and conicity.value is not None and conicity.std is not None:
                std = max(conicity.std, self.parameters.least_std)
                usable = (conicity.value, std) if std <= self.parameters.most_std else None
            self._contacts[key] = usable
        return self._contacts[key]

    def _estimates(self, wheelset: str, baseline: int) -> Sequence[_Label]:
        """Return what is known by geometries: of the mileage intervals, and the current one, which rests on more."""
        key = (wheelset, baseline)
        if key not in self._labels:
            records = list(self.unit.geometries.conicities(wheelset, baseline))
            current = (record for record in self.unit.geometries.baselines(wheelset) if record.baseline == baseline)
            records += [interval_conicities(record) for record in current]
            at_limits = [(record.mileage_km, at_limit(record.known)) for record in records if record.windows]
            self._labels[key] = [
                _Label(km, *both) for km, both in at_limits if both is not None and both[1] <= self.parameters.most_std
            ]
        return self._labels[key]


def at_limit(points: Sequence[KnownConicity]) -> tuple[float, float] | None:
    """Return conicity and std at 3 mm, extrapolated where the motion does not go as far; None where neither is known.

    Args:
        points: Of one interval, in the order of their amplitudes.
    """
    for point in points:
        if abs(point.amplitude - LIMIT_AMPLITUDE) < SAME_AMPLITUDE:
            return point.value, point.std
    below = [point for point in points if point.amplitude < LIMIT_AMPLITUDE]
    estimate = extrapolated(below) if below else None
    return None if estimate is None else (estimate.value, estimate.std)
