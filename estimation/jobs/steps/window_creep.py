"""Step: the creep of windows, with everything that it is found with as one transaction sees it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.adhesion.creep_forces import ContactForces, ForceParameters, forces_on
from estimation.adhesion.gear_segments import gear_segments
from estimation.adhesion.window_adhesion import AdhesionInputs, refused, window_adhesion
from estimation.dampers.window_damper import looked_at, window_damper
from estimation.errors import DamagedError, PurgedError
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.load_window import WindowLoader
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.jobs.steps.window_inputs import BatchInputs, WindowInputs, inputs_of_batch
from estimation.jobs.steps.window_tracks import TrackLookup, tracks_of_batch
from estimation.motion.window_motion import window_motion
from estimation.storage import UnitOfWork
from estimation.values.adhesion import WindowAdhesion
from estimation.values.dampers import WindowDamper
from estimation.values.geometry import GeometryRecord
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction, TrackSectionRecord
from estimation.values.windows import Window, WindowKey, WindowRecord


@dataclass(frozen=True, slots=True)
class CreepOfWindows:
    """What windows say of their creep, and what they say of the dampers above, of which they were read once."""

    creep: Sequence[WindowAdhesion]
    dampers: Sequence[WindowDamper]


def creep_of_windows(unit: UnitOfWork, keys: Sequence[WindowKey], settings: EstimationSettings) -> CreepOfWindows:
    """Return what is found of windows; one that is not there any more is left out."""
    records = sorted(unit.windows.several(keys), key=lambda record: (record.vehicle, record.start_ns, record.axle))
    classes = ClassLookup(unit, settings)
    batch = inputs_of_batch(unit, records, classes)
    found = _Batch(unit, batch, tracks_of_batch(unit, records), classes)
    return CreepOfWindows(found.found(records), list(found.dampers.values()))


class _Batch:
    """Windows of one transaction; the forces of a bogie are found once for both of its wheelsets."""

    def __init__(self, unit: UnitOfWork, inputs: BatchInputs, tracks: TrackLookup, classes: ClassLookup) -> None:
        self.unit, self.inputs, self.tracks, self.classes = unit, inputs, tracks, classes
        self.loader = WindowLoader(unit, inputs.vehicles, inputs.records)
        self.sections: Mapping[str, TrackSectionRecord] = {one.code: one for one in unit.tracks.sections()}
        self.geometries: dict[str, GeometryRecord | None] = {}
        self.gear: tuple[tuple[WindowKey, ...], tuple[ContactForces, ...] | Reason] | None = None
        self.dampers: dict[tuple[str, int, int], WindowDamper] = {}

    def found(self, records: Sequence[WindowRecord]) -> Sequence[WindowAdhesion]:
        """Return the creep of every window that has samples."""
        found = []
        for record in records:
            try:
                found.append(self._creep(record))
            except DamagedError as error:
                found.append(self._refused(record, Reason(ReasonCode.FILE_DAMAGED, str(error))))
            except PurgedError as error:
                found.append(self._refused(record, Reason(ReasonCode.SAMPLES_PURGED, str(error))))
        return found

    def _creep(self, record: WindowRecord) -> WindowAdhesion:
        inputs = self.inputs.of(record.key)
        section = self.sections.get(record.track_section or "")
        if isinstance(inputs.assumed, Reason):
            return self._refused(record, inputs.assumed)
        geometry = self._geometry(record.wheelset)
        if geometry is None or section is None:
            unknown = Reason(ReasonCode.NO_CREEP_CURVE, f"wheelset {record.wheelset} has no geometry on a section yet")
            return self._refused(record, unknown)
        window = self.loader.load(record, inputs.assumed.windows.vehicle_class)
        if isinstance(window, Reason):
            return self._refused(record, window)
        if inputs.position is not None and inputs.position.reason is not None:
            return self._refused(record, inputs.position.reason)
        return self._found(record, window, inputs, inputs.assumed, geometry, section)

    def _found(
        self,
        record: WindowRecord,
        window: Window,
        inputs: WindowInputs,
        assumed: Assumed,
        geometry: GeometryRecord,
        section: TrackSectionRecord,
    ) -> WindowAdhesion:
        position, correction = inputs.position, None
        if position is not None and position.content_digest == record.content_digest:
            correction = Correction(position.offset_m, position.scale, position.middle_m)
        turned = inputs.mounting is not None and inputs.mounting.reversed
        track, layout = self.tracks.alignment(record), self.tracks.layout(record)
        motion = window_motion(window, track, assumed.windows, correction, mounted_reversed=turned, layout=layout)
        own = AdhesionInputs(
            assumed.windows,
            geometry.geometry,
            self.classes.wheelset(record.wheelset).wheel_profile,
            section,
            turned,
            correction or Correction(),
        )
        forces = self._forces(record, window, assumed)
        return window_adhesion(window, record.content_digest, forces, motion, own)

    def _forces(self, record: WindowRecord, window: Window, assumed: Assumed) -> ContactForces | Reason:
        """Return the forces on the wheelset of a window; those of its gear are kept for the other axle."""
        key = self._gear(record, assumed, backwards=window.backwards)
        if isinstance(key, Reason):
            return key
        if self.gear is None or self.gear[0] != key:
            gear = self._loaded(key, window, assumed)
            if isinstance(gear, Reason):
                return gear
            self.gear = key, self._gear_forces(gear, assumed)
        forces = self.gear[1]
        return forces if isinstance(forces, Reason) else forces[key.index(record.key)]

    def _gear_forces(self, gear: tuple[Window, ...], assumed: Assumed) -> tuple[ContactForces, ...] | Reason:
        """Return the forces on a running gear; what its damper shows is kept beside."""
        segments = gear_segments(gear, assumed.windows.vehicle_class, assumed.windows.signals)
        first = min(gear, key=lambda window: window.axle)
        record = self.inputs.records.get((first.wheelset, first.start_ns))
        if record is not None and record.implausible is None and looked_at(first):
            found = window_damper(first, record.content_digest, segments, assumed.on_file)
            self.dampers[found.vehicle, found.first_axle, found.start_ns] = found
        if isinstance(segments, Reason):
            return segments
        return forces_on(segments, assumed.windows.vehicle_class, ForceParameters())

    def _gear(self, record: WindowRecord, assumed: Assumed, *, backwards: bool) -> tuple[WindowKey, ...] | Reason:
        """Return the windows of the running gear of a window, the axle first that meets the track first."""
        axle = assumed.windows.vehicle_class.partner(record.axle)
        if axle is None:
            return (record.key,)
        mounting = self.inputs.vehicles.mounting_at(record.vehicle, axle, record.start_ns)
        if mounting is None or (mounting.wheelset, record.start_ns) not in self.inputs.records:
            return Reason(ReasonCode.FRAME_UNKNOWN, f"the other axle of the bogie, axle {axle}, has no window")
        other = (mounting.wheelset, record.start_ns)
        return (record.key, other) if (record.axle < axle) != backwards else (other, record.key)

    def _loaded(self, keys: tuple[WindowKey, ...], window: Window, assumed: Assumed) -> tuple[Window, ...] | Reason:
        """Return the windows of a running gear; one of them is at hand."""
        loaded = []
        for key in keys:
            one = window
            if key != (window.wheelset, window.start_ns):
                found = self.loader.load(self.inputs.records[key], assumed.windows.vehicle_class)
                if isinstance(found, Reason):
                    return found
                one = found
            loaded.append(one)
        return tuple(loaded)

    def _geometry(self, wheelset: str) -> GeometryRecord | None:
        if wheelset not in self.geometries:
            self.geometries[wheelset] = self.unit.geometries.current(wheelset)
        return self.geometries[wheelset]

    def _refused(self, record: WindowRecord, reason: Reason) -> WindowAdhesion:
        return refused(
            record.wheelset, record.start_ns, record.vehicle, record.track_section, record.content_digest, reason
        )
