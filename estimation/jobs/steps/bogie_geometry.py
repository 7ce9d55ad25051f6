"""The geometry of a wheelset whose yaw spring hides how it rolls: from both axles of its bogie together.

Its samples are read again, of windows that stand for all: chosen by their time, so that both wheelsets of a bogie
choose the same ones, and a new window seldom changes which.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from estimation.bogie.fit import Beforehand, BogieFit, GroupedRun, fit_bogie
from estimation.bogie.geometry import curve_replicates
from estimation.bogie.parameters import BOGIE
from estimation.bogie.runs import AxleWindow, bogie_runs
from estimation.errors import DamagedError, NotFoundError
from estimation.geometry.conicity import CurveReplicates
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.parameters import JOBS, WORK
from estimation.jobs.steps.assumptions import Assumed, Membership
from estimation.jobs.steps.load_window import WindowLoader, certain_stretches
from estimation.jobs.steps.rolling import Part, members
from estimation.motion.checks import away_from_low_adhesion
from estimation.storage import UnitOfWork
from estimation.tables.bin_table import BinParameters
from estimation.values.fields import JsonValue
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting
from estimation.values.roll_up import Member
from estimation.values.track import AlignmentSource, Correction
from estimation.values.windows import Window, WindowRecord
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
    return BogieWindows(unit).fitted(sorted(windows, key=lambda member: member.start_ns), assumed)


_Key = tuple[str, ...]
_FITS: OrderedDict[_Key, tuple[BogieFit | Reason, float]] = OrderedDict()  # the other wheelset asks for the same


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
        axle = (chosen[-1].window.record.axle - 1) % 2
        pairs = [(member, self._other(member.window.record)) for member in chosen]
        keys = sorted(
            f"{member.start_ns} {sorted([member.window.record.content_digest, other.content_digest])}"
            f" {member.window.track_version}"
            for member, other in pairs
            if other is not None
        )
        key = (assumed.digest, *keys)
        if key not in _FITS:
            runs, speed = self._runs([pair for pair in pairs if pair[1] is not None], assumed)
            vehicle_class = assumed.window_parameters.vehicle_class
            noise = displacement_noise(vehicle_class, BOGIE.carried_wave, np.array([speed]))
            _FITS[key] = fit_bogie(Beforehand.of(vehicle_class), runs), float(np.sqrt(noise[0]))
            if len(_FITS) > WORK.fits_in_memory:
                _FITS.popitem(last=False)
        fit, std = _FITS[key]
        return FittedBogie(fit, axle, len(keys), std)

    def _chosen(self, members: Sequence[Member]) -> list[Member]:
        """Return the windows that stand for all: on the vehicle of the newest, on a recorded alignment."""
        usable = [member for member in members if not member.window.samples_purged and self._recorded(member)]
        if not usable:
            return []
        newest = usable[-1].window.record
        same = [m for m in usable if (m.window.record.vehicle, m.window.record.axle) == (newest.vehicle, newest.axle)]
        by_chance = sorted(same, key=lambda m: hashlib.sha256(f"{newest.vehicle} {m.start_ns}".encode()).digest())
        return sorted(by_chance[: JOBS.bogie_windows], key=lambda m: m.start_ns)

    def _recorded(self, member: Member) -> bool:
        record, version = member.window.record, member.window.track_version
        if record.track_section is None or version is None:
            return False
        track = self.unit.tracks.alignment(record.track_section, version)
        return track is not None and track.source is AlignmentSource.RECORDED

    def _mounting(self, record: WindowRecord, axle: int) -> Mounting | None:
        return self.unit.registry.mounting_at(record.vehicle, axle, record.start_ns)

    def _other(self, record: WindowRecord) -> WindowRecord | None:
        """Return the window on the other axle of the bogie."""
        mounting = self._mounting(record, record.axle + 1 if record.axle % 2 else record.axle - 1)
        return None if mounting is None else self.unit.windows.get(mounting.wheelset, record.start_ns)

    def _runs(self, pairs: Sequence[tuple[Member, Any]], assumed: Assumed) -> tuple[list[GroupedRun], float]:
        runs: list[GroupedRun] = []
        speeds = []
        for number, (member, other) in enumerate(pairs):
            group = number * BOGIE.groups // max(len(pairs), BOGIE.groups)
            for run in self._runs_of(member, other, assumed):
                runs.append((group, run))
                speeds.append(float(run.speed.mean()))
        return runs, float(np.mean(speeds)) if speeds else BOGIE.usual_speed

    def _runs_of(self, member: Member, other: WindowRecord, assumed: Assumed) -> Iterator[Any]:
        own = member.window.record
        records = sorted([own, other], key=lambda record: record.axle)
        section = own.track_section
        assert section is not None
        track, layout = (
            self.unit.tracks.alignment(section, member.window.track_version),
            self.unit.tracks.layout(section),
        )
        low = certain_stretches(self.unit, section, [own.start_ns])[own.start_ns]
        axles = []
        for record in records:
            window, correction = self._loaded(record, assumed), self._correction(record)
            kept = window if isinstance(window, Reason) else away_from_low_adhesion(window, low, correction)
            if isinstance(kept, Reason):
                return
            axles.append(AxleWindow(kept, correction))
        if track is None:
            return
        swapped = axles[0].window.backwards
        leading, trailing = reversed(axles) if swapped else axles
        yield from bogie_runs(leading, trailing, track, assumed.window_parameters, layout, swapped=swapped)

    def _loaded(self, record: WindowRecord, assumed: Assumed) -> Window | Reason:
        try:
            return self._loader.load(record, assumed.window_parameters.vehicle_class)
        except (NotFoundError, DamagedError) as error:
            return Reason(ReasonCode.FILE_DAMAGED, str(error))

    def _correction(self, record: WindowRecord) -> Correction | None:
        at = self.unit.tracks.position(record.wheelset, record.start_ns)
        if at is None or at.content_digest != record.content_digest:
            return None
        return Correction(at.offset_m, at.scale, at.middle_m)
