"""Step: the creep of windows, with what it is found with as one transaction sees it; and their friction, pooled."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from estimation.adhesion.creep_forces import ContactForces, FileErrors, FrictionParameters, forces_on, gear_segments
from estimation.adhesion.window_adhesion import AdhesionInputs, refused, window_adhesion
from estimation.alerts.rules.running_gear import LowAdhesionRule
from estimation.dampers.damper import looked_at, window_damper
from estimation.errors import DamagedError, PurgedError
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.assumptions import Assumed, ClassLookup
from estimation.jobs.steps.load_window import BatchInputs, WindowLoader, inputs_of_batch
from estimation.motion.window_motion import window_motion
from estimation.storage import UnitOfWork
from estimation.values.opinions import WindowAdhesion, WindowDamper
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackAlignment, TrackLayout, TrackSectionRecord
from estimation.values.units import HOUR_NS
from estimation.values.windows import Window, WindowKey, WindowRecord


@dataclass(slots=True)
class Gear:
    """A running gear at a time; its forces are found once for all of its wheelsets, where one is first asked for."""

    windows: tuple[Window, ...]  # the axle first that meets the track first
    assumed: Assumed
    content_digest: str | None  # of the samples of its first axle; None where it says nothing of the damper
    _forces: tuple[ContactForces, ...] | Reason | None = None
    damper: WindowDamper | None = None

    def forces(self, place: int) -> ContactForces | Reason:
        """Return the forces on the wheelset at a place of ``windows``."""
        if self._forces is None:
            vehicle_class = self.assumed.window_parameters.vehicle_class
            segments = gear_segments(self.windows, vehicle_class, self.assumed.window_parameters.signals)
            if self.content_digest is not None:
                first = min(self.windows, key=lambda window: window.axle)
                self.damper = window_damper(first, self.content_digest, segments, self.assumed.on_file)
            self._forces = segments if isinstance(segments, Reason) else forces_on(segments, vehicle_class)
        return self._forces if isinstance(self._forces, Reason) else self._forces[place]


@dataclass(frozen=True, slots=True)
class Run:
    """A window on the track that it ran on."""

    window: Window
    track: TrackAlignment | None
    layout: TrackLayout | None
    position: Correction | None
    assumed: Assumed
    own: AdhesionInputs
    gear: Gear | Reason
    place: int  # of the window in its gear


@dataclass(frozen=True, slots=True)
class CreepInputs:
    """What the creep of a window is found from."""

    record: WindowRecord
    refused: Reason | None  # what is said of it where it is not used
    run: Run | None = field(default=None, metadata={"made_from": False})


@dataclass(frozen=True, slots=True)
class CreepOfWindow:
    """What a window says of its creep, and of the damper above."""

    creep: WindowAdhesion
    damper: WindowDamper | None = None


def creep_of_window(inputs: CreepInputs) -> CreepOfWindow:
    """Return the creep of a window, or why it has none."""
    record, run = inputs.record, inputs.run
    if run is None:
        assert inputs.refused is not None
        key = (record.wheelset, record.start_ns, record.vehicle, record.track_section, record.content_digest)
        return CreepOfWindow(refused(*key, inputs.refused))
    motion = window_motion(
        run.window,
        run.track,
        run.assumed.window_parameters,
        run.position,
        mounted_reversed=run.own.mounted_reversed,
        layout=run.layout,
    )
    gear = run.gear
    forces = gear if isinstance(gear, Reason) else gear.forces(run.place)
    creep = window_adhesion(run.window, record.content_digest, forces, motion, run.own)
    return CreepOfWindow(creep, None if isinstance(gear, Reason) else gear.damper)


def creep_inputs(
    unit: UnitOfWork, records: Sequence[WindowRecord], settings: EstimationSettings
) -> Mapping[WindowKey, CreepInputs]:
    """Return what the creep of windows with samples is found from, as one transaction sees it."""
    records = sorted(records, key=lambda record: (record.vehicle, record.start_ns, record.axle))
    classes = ClassLookup(unit, settings)
    batch = _Batch(unit, inputs_of_batch(unit, records, classes), classes)
    return {record.key: batch.of(record) for record in records}


class _Batch:
    """Windows of one transaction."""

    def __init__(self, unit: UnitOfWork, inputs: BatchInputs, classes: ClassLookup) -> None:
        self.unit, self.inputs, self.classes = unit, inputs, classes
        self.loader = WindowLoader(unit, inputs.records)
        self.sections: Mapping[str, TrackSectionRecord] = {section.code: section for section in unit.tracks.sections()}
        self.gears: dict[tuple[WindowKey, ...], Gear | Reason] = {}

    def of(self, record: WindowRecord) -> CreepInputs:
        """Return what the creep of a window is found from."""
        try:
            found = self._run(record)
        except DamagedError as error:
            found = Reason(ReasonCode.FILE_DAMAGED, str(error))
        except PurgedError as error:
            found = Reason(ReasonCode.SAMPLES_PURGED, str(error))
        return CreepInputs(record, found) if isinstance(found, Reason) else CreepInputs(record, None, found)

    def _run(self, record: WindowRecord) -> Run | Reason:
        inputs = self.inputs.found[record.key]
        section, assumed = self.sections.get(record.track_section or ""), inputs.assumed
        if isinstance(assumed, Reason):
            return assumed
        geometry = self.unit.geometries.current(record.wheelset)
        if geometry is None or section is None:
            return Reason(ReasonCode.NO_CREEP_CURVE, f"wheelset {record.wheelset} has no geometry on a section yet")
        window = self.loader.load(record, assumed.window_parameters.vehicle_class)
        if isinstance(window, Reason):
            return window
        if inputs.position is not None and inputs.position.reason is not None:
            return inputs.position.reason
        correction, turned = inputs.correction(record), inputs.mounted_reversed
        profile = self.classes.wheelset(record.wheelset).wheel_profile
        at = correction or Correction()
        own = AdhesionInputs(assumed.window_parameters, geometry.geometry, profile, section, turned, at)
        gear, place = self._gear(record, window, assumed)
        track, layout = self.inputs.alignment(record), self.inputs.layout(record)
        return Run(window, track, layout, correction, assumed, own, gear, place)

    def _gear(self, record: WindowRecord, window: Window, assumed: Assumed) -> tuple[Gear | Reason, int]:
        """Return the running gear of a window, and the place of the window there."""
        keys = self._keys(record, assumed, backwards=window.backwards)
        if isinstance(keys, Reason):
            return keys, 0
        if keys not in self.gears:
            self.gears[keys] = self._loaded(keys, window, assumed)
        return self.gears[keys], keys.index(record.key)

    def _keys(self, record: WindowRecord, assumed: Assumed, *, backwards: bool) -> tuple[WindowKey, ...] | Reason:
        """Return the windows of the running gear of a window, the axle first that meets the track first."""
        axle = assumed.window_parameters.vehicle_class.partner(record.axle)
        if axle is None:
            return (record.key,)
        mounting = self.unit.registry.mounting_at(record.vehicle, axle, record.start_ns)
        if mounting is None or (mounting.wheelset, record.start_ns) not in self.inputs.records:
            return Reason(ReasonCode.FRAME_UNKNOWN, f"the other axle of the bogie, axle {axle}, has no window")
        other = (mounting.wheelset, record.start_ns)
        return (record.key, other) if (record.axle < axle) != backwards else (other, record.key)

    def _loaded(self, keys: tuple[WindowKey, ...], window: Window, assumed: Assumed) -> Gear | Reason:
        """Return a running gear with its windows; one of them is at hand."""
        loaded = []
        for key in keys:
            one = window
            if key != (window.wheelset, window.start_ns):
                found = self.loader.load(self.inputs.records[key], assumed.window_parameters.vehicle_class)
                if isinstance(found, Reason):
                    return found
                one = found
            loaded.append(one)
        first = min(loaded, key=lambda each: each.axle)
        record = self.inputs.records.get((first.wheelset, first.start_ns))
        says = record is not None and record.implausible is None and looked_at(first)
        return Gear(tuple(loaded), assumed, record.content_digest if says and record is not None else None)


def pooled_ns(rule: LowAdhesionRule) -> int:
    """Return how long passes are pooled, ns."""
    return round(rule.pooled_hours * HOUR_NS)


def friction_parameters(
    rule: LowAdhesionRule, unit: UnitOfWork, passes: Sequence[WindowAdhesion]
) -> FrictionParameters:
    """Return the limits of a rule as the friction of a section is found with them, and what the file leaves open.

    A vehicle whose class is not on file counts as one without stds of its own.
    """
    codes = {unit.registry.vehicle(code).vehicle_class for code in {window_pass.vehicle for window_pass in passes}}
    found = [unit.registry.vehicle_class(code) for code in sorted(codes)]
    file = FileErrors.of([one.vehicle_class for one in found if one is not None])
    return FrictionParameters(low=rule.raise_friction, likely=rule.raise_probability, file=file)


def pool_ends(starts: Collection[int], length_ns: int) -> Sequence[int]:
    """Return the ends of as few spans, both ends included, as hold all times; oldest first, the last is the newest."""
    ends: list[int] = []
    for start in sorted(set(starts), reverse=True):
        if not ends or ends[-1] - start > length_ns:
            ends.append(start)
    return ends[::-1]
