"""The geometry of a wheelset whose yaw spring hides how it rolls: from both axles of its bogie together.

Its samples are read again, of windows that stand for all: chosen by their time, so that both wheelsets of a bogie
choose the same ones, and a new window seldom changes which.
"""

from __future__ import annotations

import hashlib
import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimation.bogie.fit import Beforehand, BogieFit, GroupedRun, fit_bogie
from estimation.bogie.geometry import curve_replicates, spring_differs
from estimation.bogie.parameters import BOGIE, BOGIE_TRACK
from estimation.bogie.runs import AxleWindow, bogie_runs
from estimation.bogie.signals import BogieRun
from estimation.errors import DamagedError, NotFoundError
from estimation.geometry.conicity import CurveReplicates
from estimation.geometry.uncertainty import ParameterUncertainty, alignment_std
from estimation.jobs.parameters import JOBS, WORK
from estimation.jobs.stage import made_from
from estimation.jobs.steps.assumptions import Assumed, Membership
from estimation.jobs.steps.load_window import Stretches, WindowLoader, correction_of, low_adhesion
from estimation.jobs.steps.rolling import Part, members
from estimation.motion.checks import away_from_low_adhesion
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import BinParameters
from estimation.values.fields import JsonValue
from estimation.values.geometry import Contradiction
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.roll_up import Member
from estimation.values.track import AlignmentSource, Correction, TrackAlignment, TrackLayout
from estimation.values.windows import Window, WindowKey, WindowRecord
from estimation.vehicle.vehicle_class import VehicleClass, displacement_noise

BOGIE_FOUND = "bogie"
"""Name under which a geometry keeps what its bogie was found to be."""


def held_by_spring(vehicle_class: VehicleClass) -> bool:
    """Return whether the yaw spring of a bogie carries most of the moment by which its wheelsets would steer."""
    if vehicle_class.bogie is None:
        return False
    p = vehicle_class.parameters
    rolling = 2.0 * p.half_contact_distance**2 * p.longitudinal_creep_coefficient * 2.0 * np.pi / BOGIE.usual_wave
    return bool(p.yaw_stiffness >= BOGIE.least_spring_share * (p.yaw_stiffness + rolling))


def known_well(track: TrackAlignment | None) -> bool:
    """Return whether a bogie can be estimated as one over an alignment: a survey, or one that the fleet knows well."""
    if track is None or track.source is AlignmentSource.RECORDED:
        return track is not None
    return alignment_std(track, ParameterUncertainty()) <= BOGIE_TRACK.most_std


@dataclass(frozen=True, slots=True)
class FittedBogie:
    """What the bogie of a wheelset was found to be."""

    fit: BogieFit | Reason
    axle: int  # of the wheelset in its bogie, 0 or 1
    windows: int
    sensors_std: float  # m, of y - d by the sensors

    def replicates(self, bins: BinParameters, uncertainty: ParameterUncertainty) -> CurveReplicates | Reason:
        """Return R of the wheelset, or why there is none."""
        if isinstance(self.fit, Reason):
            return self.fit
        return curve_replicates(self.fit, self.axle, bins.edges, uncertainty, self.sensors_std, float(self.windows))

    def against(self, vehicle_class: VehicleClass) -> Contradiction | None:
        """Return what it says against the class of its vehicle.

        Where a stiff bogie does not move as one of its class, a wheelset alone is as wrong and does not show it.
        """
        if isinstance(self.fit, Reason):
            return Contradiction(self.fit, certain=self.fit.code is ReasonCode.MOTION_UNEXPLAINED, relative=0.0)
        stds = (vehicle_class.std_of(name) for name in ("yaw_stiffness", "longitudinal_creep_coefficient"))
        return spring_differs(self.fit, math.hypot(*stds))


def stated_of(found: FittedBogie | None) -> Mapping[str, JsonValue]:
    """Return what a geometry keeps of its bogie among its parameters."""
    if found is None:
        return {}
    if isinstance(found.fit, Reason):
        return {BOGIE_FOUND: {"code": found.fit.code.value, "text": found.fit.text}}
    names = ("stiffness_ratio", "stiffness_ratio_std", "inverse_friction", "inverse_friction_std")
    values = (*found.fit.stiffness_ratio, *found.fit.inverse_friction)
    of_bogie: dict[str, JsonValue] = dict(zip(names, values, strict=True))
    return {BOGIE_FOUND: of_bogie | {"windows": found.windows, "likeness": float(found.fit.likeness.min())}}


def bogie_of(unit: UnitOfWork, rules: Membership, parts: Sequence[Part], assumed: Assumed) -> FittedBogie | None:
    """Return what the windows of some roll-ups say of their bogie; None where wheelsets are estimated alone."""
    if not held_by_spring(assumed.window_parameters.vehicle_class):
        return None
    windows = [member for part in parts for member in members(unit, rules, part)]
    newest_km = max((member.mileage_km for member in windows), default=0.0)
    from_km = newest_km - JOBS.bogie_half_lives * rules.half_life_km
    recent = [member for member in windows if member.mileage_km >= from_km]
    return BogieWindows(unit).fitted(sorted(recent, key=lambda member: member.start_ns), assumed)


# by the digest of all that they are made from: the other wheelset asks for the same
_FITS: OrderedDict[str, tuple[BogieFit | Reason, float]] = OrderedDict()


@dataclass(frozen=True, slots=True)
class _Pair:
    """The windows of both axles of a bogie at one time, and what they are read with."""

    records: tuple[WindowRecord, WindowRecord]  # by axle
    corrections: tuple[Correction | None, ...]
    low: Stretches  # of low friction
    on_track: str  # digest of the next two
    track: TrackAlignment
    layout: TrackLayout | None

    @property
    def made_from(self) -> tuple[object, ...]:
        """All that a fit is made from."""
        return *(record.content_digest for record in self.records), self.corrections, self.low, self.on_track


@dataclass(frozen=True, slots=True)
class BogieWindows:
    """Reads the windows of bogies, as one transaction sees them."""

    unit: UnitOfWork
    _loader: WindowLoader = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_loader", WindowLoader(self.unit))

    def fitted(self, members: Sequence[Member], assumed: Assumed) -> FittedBogie | None:
        """Return what windows of a wheelset say of its bogie; None where no alignment with long waves is on file."""
        chosen = self._chosen(members)
        if not chosen:
            return None
        vehicle_class = assumed.window_parameters.vehicle_class
        pairs = list(self._pairs(chosen, vehicle_class))
        key = made_from(assumed.digest, [pair.made_from for pair in pairs])
        if key not in _FITS:
            runs, speed = self._runs(pairs, assumed)
            noise = displacement_noise(vehicle_class, BOGIE.carried_wave, np.array([speed]))
            _FITS[key] = fit_bogie(Beforehand.of(vehicle_class), runs), float(np.sqrt(noise[0]))
            if len(_FITS) > WORK.fits_in_memory:
                _FITS.popitem(last=False)
        fit, std = _FITS[key]
        return FittedBogie(fit, (chosen[-1].window.record.axle - 1) % 2, len(pairs), std)

    def _chosen(self, members: Sequence[Member]) -> list[Member]:
        """Return the windows that stand for all: on the vehicle of the newest, on an alignment that is known well."""
        usable = [
            member for member in members if not member.window.samples_purged and known_well(self._alignment(member))
        ]
        if not usable:
            return []
        newest = usable[-1].window.record
        same = [m for m in usable if (m.window.record.vehicle, m.window.record.axle) == (newest.vehicle, newest.axle)]
        by_chance = sorted(same, key=lambda m: hashlib.sha256(f"{newest.vehicle} {m.start_ns}".encode()).digest())
        return sorted(by_chance[: JOBS.bogie_windows], key=lambda m: m.start_ns)

    def _alignment(self, member: Member) -> TrackAlignment | None:
        section, version = member.window.record.track_section, member.window.track_version
        return None if section is None or version is None else self.unit.tracks.alignment(section, version)

    def _pairs(self, chosen: Sequence[Member], vehicle_class: VehicleClass) -> Iterator[_Pair]:
        """Yield the windows of both axles; those without one on the other axle are left out."""
        own = [member.window.record for member in chosen]
        partners = {record.key: self._partner_key(record, vehicle_class) for record in own}
        others = {record.key: record for record in self.unit.windows.several([key for key in partners.values() if key])}
        positions = self.unit.tracks.positions([*partners, *others])
        low, on_tracks = low_adhesion(self.unit, own), dict[int, str]()
        for member, record in zip(chosen, own, strict=True):
            other, track = others.get(partners[record.key] or record.key), self._alignment(member)
            if other is None or track is None:
                continue
            layout = self.unit.tracks.layout(track.section)
            if id(track) not in on_tracks:  # the transaction reads each once
                on_tracks[id(track)] = made_from(track, layout)
            first, second = sorted([record, other], key=lambda record: record.axle)
            corrections = tuple(correction_of(record, positions.get(record.key)) for record in (first, second))
            yield _Pair((first, second), corrections, low.get(record.key, ()), on_tracks[id(track)], track, layout)

    def _partner_key(self, record: WindowRecord, vehicle_class: VehicleClass) -> WindowKey | None:
        axle = vehicle_class.partner(record.axle)
        mounting = None if axle is None else self.unit.registry.mounting_at(record.vehicle, axle, record.start_ns)
        return None if mounting is None else (mounting.wheelset, record.start_ns)

    def _runs(self, pairs: Sequence[_Pair], assumed: Assumed) -> tuple[list[GroupedRun], float]:
        runs: list[GroupedRun] = []
        for number, pair in enumerate(pairs):
            group = number * BOGIE.groups // max(len(pairs), BOGIE.groups)
            runs += [(group, run) for run in self._runs_of(pair, assumed)]
        speeds = [float(run.speed.mean()) for _, run in runs]
        return runs, float(np.mean(speeds)) if speeds else BOGIE.usual_speed

    def _runs_of(self, pair: _Pair, assumed: Assumed) -> Iterator[BogieRun]:
        axles = []
        for record, correction in zip(pair.records, pair.corrections, strict=True):
            window = self._loaded(record, assumed)
            kept = window if isinstance(window, Reason) else away_from_low_adhesion(window, pair.low, correction)
            if isinstance(kept, Reason):
                return
            axles.append(AxleWindow(kept, correction))
        swapped = axles[0].window.backwards
        leading, trailing = reversed(axles) if swapped else axles
        yield from bogie_runs(leading, trailing, pair.track, assumed.window_parameters, pair.layout, swapped=swapped)

    def _loaded(self, record: WindowRecord, assumed: Assumed) -> Window | Reason:
        try:
            return self._loader.load(record, assumed.window_parameters.vehicle_class)
        except (NotFoundError, DamagedError) as error:
            return Reason(ReasonCode.FILE_DAMAGED, str(error))
