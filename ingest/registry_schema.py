"""Schema of a registry file: one class per kind of entry, in the units of the file."""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, ConfigDict, Field, model_validator

from estimation.values.registry import (
    FleetRecord,
    Mounting,
    Reprofiling,
    SensorChange,
    SensorWork,
    VehicleRecord,
    WheelsetRecord,
)
from estimation.values.track import TrackSectionRecord
from ingest.input_file import Code, FreeText, InputTable, NotNegative, Positive, Text, field_error

FORMAT = "treadwatch-registry-1"
MAX_AXLES = 8
FIRST_YEAR, LAST_YEAR = 1900, 2200  # ns since 1970 end in 2262
MOST_KM = 1e8
FARTHEST_M = 1000.0  # of an axle from the reference point
MOST_TONNAGE_MGT = 1000.0  # a year, on one section
_DECIMALS = re.compile(r"[.,](\d+)")  # of a second
PROFILES_STD_MM = 0.1  # of the lateral displacement that follows from measured profiles


def _nanoseconds(value: object) -> int:
    """Return a time in ISO 8601 with its offset from UTC as ns since 1970."""
    try:
        moment = datetime.fromisoformat(value) if isinstance(value, str) else None
    except ValueError:
        moment = None
    if moment is None or moment.tzinfo is None:
        raise field_error(f"{value!r} is not a time with its offset from UTC, as in 2024-01-08T05:30:00Z")
    since = moment.replace(microsecond=0) - datetime(1970, 1, 1, tzinfo=UTC)
    if not FIRST_YEAR <= moment.year <= LAST_YEAR:
        raise field_error(f"{value!r} is outside the years {FIRST_YEAR} to {LAST_YEAR}")
    decimals = _DECIMALS.search(str(value))
    rest_ns = int(decimals[1][:9].ljust(9, "0")) if decimals else 0
    return (since.days * 86_400 + since.seconds) * 1_000_000_000 + rest_ns


Kilometres = Annotated[float, Field(ge=0.0, le=MOST_KM)]
MomentNs = Annotated[int, BeforeValidator(_nanoseconds)]


class FleetEntry(InputTable):
    """An entry of ``fleets``."""

    code: Code
    name: Text

    def record(self) -> FleetRecord:
        """Return the fleet."""
        return FleetRecord(self.code, self.name)


class VehicleEntry(InputTable):
    """An entry of ``vehicles``."""

    code: Code
    fleet: Code
    vehicle_class: Code
    axles: int = Field(ge=1, le=MAX_AXLES)
    max_speed_km_h: float = Field(ge=1.0, le=600.0)
    axle_offsets_m: list[Annotated[float, Field(ge=-FARTHEST_M, le=FARTHEST_M)]]

    @model_validator(mode="after")
    def _check_offsets(self) -> Self:
        if len(self.axle_offsets_m) != self.axles:
            raise field_error(f"{len(self.axle_offsets_m)} offsets for {self.axles} axles", "axle_offsets_m")
        if len(set(self.axle_offsets_m)) < self.axles:
            raise field_error("two axles are at one place", "axle_offsets_m")
        return self

    def record(self) -> VehicleRecord:
        """Return the vehicle in SI units."""
        return VehicleRecord(
            code=self.code,
            fleet=self.fleet,
            vehicle_class=self.vehicle_class,
            axles=self.axles,
            max_speed_m_s=self.max_speed_km_h / 3.6,
            axle_offsets_m=tuple(self.axle_offsets_m),
        )


class WheelsetEntry(InputTable):
    """An entry of ``wheelsets``."""

    serial: Code
    fleet: Code
    wheel_profile: Text
    nominal_radius_mm: float = Field(ge=100.0, le=1000.0)

    def record(self) -> WheelsetRecord:
        """Return the wheelset in SI units, without its mounting."""
        return WheelsetRecord(
            serial=self.serial,
            fleet=self.fleet,
            wheel_profile=self.wheel_profile,
            nominal_radius_m=1e-3 * self.nominal_radius_mm,
            mounting=None,
        )


class MountingEntry(InputTable):
    """An entry of ``mountings``."""

    wheelset: Code
    vehicle: Code
    axle: int = Field(ge=1, le=MAX_AXLES)
    from_ns: MomentNs = Field(alias="from")
    to_ns: MomentNs | None = Field(default=None, alias="to")
    vehicle_odometer_km: Kilometres
    wheelset_mileage_km: Kilometres
    reversed: bool = False

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.to_ns is not None and self.to_ns <= self.from_ns:
            raise field_error("must be later than 'from'", "to")
        return self

    def record(self) -> Mounting:
        """Return the mounting; times in ns since 1970, distances in km."""
        return Mounting(
            wheelset=self.wheelset,
            vehicle=self.vehicle,
            axle=self.axle,
            from_ns=self.from_ns,
            to_ns=self.to_ns,
            vehicle_odometer_km=self.vehicle_odometer_km,
            wheelset_mileage_km=self.wheelset_mileage_km,
            reversed=self.reversed,
        )


class ReprofilingEntry(InputTable):
    """An entry of ``reprofilings``."""

    wheelset: Code
    at: MomentNs
    mileage_km: Kilometres
    note: FreeText = ""

    def record(self) -> Reprofiling:
        """Return the reprofiling; time in ns since 1970, mileage in km."""
        return Reprofiling(wheelset=self.wheelset, at_ns=self.at, mileage_km=self.mileage_km, note=self.note)


class SensorChangeEntry(InputTable):
    """An entry of ``sensor_changes``."""

    vehicle: Code
    axle: int = Field(ge=1, le=MAX_AXLES)
    at: MomentNs
    work: Literal["swap", "calibration"]
    removed: FreeText = ""
    fitted: FreeText = ""
    note: FreeText = ""

    def record(self) -> SensorChange:
        """Return the work on the sensors of an axle; time in ns since 1970."""
        return SensorChange(
            self.vehicle, self.axle, self.at, SensorWork(self.work), self.removed, self.fitted, self.note
        )


class ProfileEntry(InputTable):
    """``left`` or ``right`` of a measurement."""

    file: Text


class MeasurementEntry(InputTable):
    """An entry of ``measured_profiles``."""

    wheelset: Code
    at: MomentNs
    mileage_km: Kilometres
    left: ProfileEntry
    right: ProfileEntry
    std_mm: Positive = PROFILES_STD_MM


class AlignmentEntry(InputTable):
    """``alignment`` of a track section."""

    file: Text
    alignment_std_mm: NotNegative | None = None
    gauge_deviation_std_mm: NotNegative

    @model_validator(mode="after")
    def _check_null(self) -> Self:
        if self.alignment_std_mm is None and "alignment_std_mm" in self.model_fields_set:
            raise field_error("None is not a number", "alignment_std_mm")
        return self


class LayoutEntry(InputTable):
    """``layout`` of a track section."""

    file: Text


class LineEntry(InputTable):
    """``coordinates`` of a track section."""

    file: Text


class SectionEntry(InputTable):
    """An entry of ``track_sections``."""

    code: Code
    number: int = Field(ge=1, le=65534)
    name: Text
    rail_profile: Text
    rail_inclination: float = Field(ge=0.0, le=0.5)
    nominal_gauge_mm: float = Field(ge=500.0, le=2000.0)
    length_m: float = Field(ge=1.0)
    tonnage_mgt_per_year: float | None = Field(default=None, gt=0.0, le=MOST_TONNAGE_MGT)
    alignment: AlignmentEntry | None = None
    layout: LayoutEntry | None = None
    coordinates: LineEntry | None = None

    def record(self) -> TrackSectionRecord:
        """Return the section in SI units, without its track and its line."""
        return TrackSectionRecord(
            code=self.code,
            number=self.number,
            name=self.name,
            rail_profile=self.rail_profile,
            rail_inclination=self.rail_inclination,
            nominal_gauge_m=1e-3 * self.nominal_gauge_mm,
            length_m=self.length_m,
            tonnage_mgt_per_year=self.tonnage_mgt_per_year,
        )


class ClassFileEntry(InputTable):
    """An entry of ``vehicle_classes`` that is a file of its own, beside the registry."""

    file: Text


class RecordedClassEntry(InputTable):
    """An entry of ``vehicle_classes`` as an export has it: the class as it is stored, in SI units."""

    recorded: dict[str, Any]


class ClassEntry(InputTable):
    """An entry of ``vehicle_classes``.

    A ``ClassFileEntry``, a ``RecordedClassEntry`` or a ``VehicleClassEntry``, and checked as that.
    """

    model_config = ConfigDict(extra="allow")


class RegistryObject(InputTable):
    """The whole file."""

    format: Literal["treadwatch-registry-1"]
    fleets: list[FleetEntry] = Field(default_factory=list)
    vehicle_classes: list[ClassEntry] = Field(default_factory=list)
    vehicles: list[VehicleEntry] = Field(default_factory=list)
    wheelsets: list[WheelsetEntry] = Field(default_factory=list)
    mountings: list[MountingEntry] = Field(default_factory=list)
    reprofilings: list[ReprofilingEntry] = Field(default_factory=list)
    measured_profiles: list[MeasurementEntry] = Field(default_factory=list)
    sensor_changes: list[SensorChangeEntry] = Field(default_factory=list)
    track_sections: list[SectionEntry] = Field(default_factory=list)

    @model_validator(mode="after")
    def _check_keys(self) -> Self:
        for name, key in _KEYS:
            before: set[tuple[object, ...]] = set()
            for index, entry in enumerate(getattr(self, name)):
                found = tuple(getattr(entry, part) for part in key)
                if found in before:
                    raise field_error(f"{found[0]!r} is in an entry before", name, index)
                before.add(found)
        return self


_KEYS = (  # of the entries of each array
    ("fleets", ("code",)),
    ("vehicles", ("code",)),
    ("wheelsets", ("serial",)),
    ("mountings", ("wheelset", "from_ns")),
    ("reprofilings", ("wheelset", "at")),
    ("measured_profiles", ("wheelset", "at")),
    ("sensor_changes", ("vehicle", "at")),
    ("track_sections", ("code",)),
    ("track_sections", ("number",)),
)
