"""Which wheelsets of an epoch have freshly measured profiles, and the curves of these on the section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime

from estimation.contact.profiles import MeasuredProfiles
from estimation.errors import ContactError, DamagedError, ProfileError
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.storage import UnitOfWork
from estimation.track.panel.basis import MeasuredCurve, measured_curve
from estimation.track.passes import ProfileLife
from estimation.values.reasons import Reason
from estimation.values.registry import WheelsetRecord
from estimation.values.track import TrackSectionRecord
from estimation.values.windows import WindowRecord


@dataclass(frozen=True, slots=True)
class Measured:
    """Curves by the life of a wheelset, and a note on each measurement that cannot be used."""

    curves: Mapping[ProfileLife, MeasuredCurve] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def measured(
    unit: UnitOfWork,
    section: TrackSectionRecord,
    records: Sequence[WindowRecord],
    lives: Sequence[ProfileLife],
    within_km: float,
    classes: ClassLookup,
) -> Measured:
    """Return the curves of profiles that were measured within ``within_km`` of the windows, by the lathe's last visit.

    Args:
        records, lives: Windows, and the life of its wheelset for each.
        within_km: Mileage between measurement and window at which the profile still is what it was.
        classes: Of the vehicles: sensors that measure gravity show the displacement at rail level.
    """
    curves: dict[ProfileLife, MeasuredCurve] = {}
    notes: list[str] = []
    on_file = unit.registry.newest_measurement_of({record.wheelset for record in records})
    for life, record in {life: record for record, life in zip(records, lives, strict=True)}.items():
        if record.wheelset not in on_file:
            continue
        try:
            found = _newest(unit, record, classes.wheelset(record.wheelset), within_km)
        except DamagedError as error:  # the others go on
            notes.append(str(error))
            continue
        if found is None:
            continue
        name = measurement_name(found)
        try:
            curves[life] = _curve(name, found, section, at_rails=_measures_gravity(classes, record.vehicle))
        except (ContactError, ProfileError) as error:
            notes.append(f"measured profiles of {name} are not used: {error}")
    return Measured(curves, tuple(dict.fromkeys(notes)))


def _newest(
    unit: UnitOfWork, record: WindowRecord, wheelset: WheelsetRecord, within_km: float
) -> MeasuredProfiles | None:
    """Return the last measurement of a wheelset with the profiles that it had in a window."""
    turned = [item.at_ns for item in wheelset.reprofilings]
    near = [
        item
        for item in unit.registry.measured_profiles(record.wheelset)
        if abs(item.mileage_km - record.mileage_km) <= within_km
        and all((at_ns <= item.at_ns) == (at_ns <= record.start_ns) for at_ns in turned)
    ]
    return near[-1] if near else None


def measurement_name(item: MeasuredProfiles) -> str:
    """Return how reports of alignments name a measurement."""
    return f"{item.wheelset} of {datetime.fromtimestamp(item.at_ns // 10**9, UTC):%Y-%m-%d}"


def _measures_gravity(classes: ClassLookup, vehicle: str) -> bool:
    on_file = classes.of_vehicle(vehicle)
    return not isinstance(on_file, Reason) and on_file.vehicle_class.sensors.measures_gravity


def _curve(name: str, item: MeasuredProfiles, section: TrackSectionRecord, *, at_rails: bool) -> MeasuredCurve:
    return measured_curve(
        name,
        item.left,
        item.right,
        item.std,
        rail=section.rail_profile,
        inclination=section.rail_inclination,
        gauge=section.nominal_gauge_m,
        at_rails=at_rails,
    )
