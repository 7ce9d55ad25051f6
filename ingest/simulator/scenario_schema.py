"""Schema of a scenario file: one class per TOML table, in the units of the file, and its conversion to SI."""

from __future__ import annotations

import math
from dataclasses import fields
from datetime import datetime
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.contact.wear import WearFamily, wear_course
from estimation.errors import ParameterError, ProfileError
from estimation.vehicle.equations_of_motion import VehicleParameters
from ingest.input_file import IncreasingNumbers, InputTable, NotNegative, Positive, Text, field_error
from ingest.simulator.curves import Curve
from ingest.simulator.motion import MINIMUM_SPEED
from ingest.simulator.scenario import (
    BusPlan,
    DrawnFleet,
    Fault,
    FaultKind,
    PositionErrors,
    ProfilePair,
    SectionPlan,
    Sessions,
    SpeedRange,
    VehicleErrors,
    VehiclePlan,
    WheelsetPlan,
)
from ingest.simulator.sensors import FULL_RATE_HZ, Channel, SensorNode, ideal_node
from ingest.simulator.track import TrackRecipe

MM = 1e-3
KM = 1e3
KM_PER_HOUR = 1.0 / 3.6
MICRO_G = 9.80665e-6
MIN_CURVE_RADIUS = 150.0  # m
MAX_AXLES = 8
DEFAULT_AXLE_SPACING = 2.6  # m
FLANGE_SHARE = 0.6


def _rail(name: str) -> str:
    try:
        rail_profile(name)
    except ProfileError as error:
        raise field_error(error.reason) from error
    return name


def _wheel(name: str) -> str:
    try:
        wheel_profile(name)
    except ProfileError as error:
        raise field_error(error.reason) from error
    return name


def _with_offset(moment: datetime) -> datetime:
    if moment.tzinfo is None:
        raise field_error("needs an offset from UTC, as in 2024-01-08T05:30:00Z")
    return moment


def _curve_radius(radius: float) -> float:
    if abs(radius) < MIN_CURVE_RADIUS:
        raise field_error(f"{radius:g} m is no radius; at least {MIN_CURVE_RADIUS:g} m, negative to the right")
    return radius


def _divides_full_rate(rate: int) -> int:
    if FULL_RATE_HZ % rate:
        raise field_error(f"{rate} Hz does not divide {FULL_RATE_HZ} Hz")
    return rate


def _fault_kind(kind: str) -> str:
    if kind not in tuple(FaultKind):
        raise field_error(f"{kind!r} is none of {', '.join(FaultKind)}")
    return kind


def _known_parameters(given: dict[str, float]) -> dict[str, float]:
    known = [item.name for item in fields(VehicleParameters)]
    for key in given:
        if key not in known:
            raise field_error(f"unknown key; known here: {', '.join(known)}", key)
    try:
        VehicleParameters(**given)
    except ParameterError as error:
        raise field_error(error.reason, *([error.field] if error.field else [])) from error
    return given


DynamicsTable = Annotated[dict[str, NotNegative], AfterValidator(_known_parameters)]
"""``[dynamics]``: parameters of the vehicle by their names, in SI units."""

RailName = Annotated[Text, AfterValidator(_rail)]
WheelName = Annotated[Text, AfterValidator(_wheel)]
Moment = Annotated[datetime, AfterValidator(_with_offset)]


class FleetTable(InputTable):
    """``[fleet]``."""

    code: Text
    name: Text


class CurveTable(InputTable):
    """``[[section.curves]]``."""

    start_m: NotNegative
    length_m: Positive
    radius_m: Annotated[float, Field(ge=-1e6, le=1e6), AfterValidator(_curve_radius)]
    cant_mm: float = Field(default=0.0, ge=-200.0, le=200.0)
    transition_m: Positive = 80.0

    @model_validator(mode="after")
    def _check_transitions(self) -> Self:
        if self.length_m <= 2.0 * self.transition_m:
            raise field_error(f"{self.length_m:g} m is no longer than both transitions", "length_m")
        return self

    def plan(self) -> Curve:
        """Return the curve in SI units."""
        return Curve(
            start=self.start_m,
            length=self.length_m,
            radius=self.radius_m,
            cant=MM * self.cant_mm,
            transition=self.transition_m,
        )


class SectionTable(InputTable):
    """``[section]``."""

    code: Text
    number: int = Field(ge=1, le=65534)
    name: Text
    rail_profile: RailName = "56E1"
    rail_inclination_1_in: float = Field(default=20.0, ge=5.0)
    nominal_gauge_mm: float = Field(default=1435.0, ge=500.0, le=2000.0)
    survey_alignment_std_mm: NotNegative = 0.0
    survey_gauge_std_mm: NotNegative = 0.0
    surveyed: bool = True
    gauge_surveyed: bool = False
    latitude_deg: float = Field(default=51.5, ge=-90.0, le=90.0)
    longitude_deg: float = Field(default=-0.2, ge=-180.0, le=180.0)
    file: Text | None = None
    length_m: Positive | None = None
    interval_m: Positive = 0.25
    shortest_wavelength_m: Positive = 3.0
    longest_wavelength_m: Positive = 70.0
    alignment_std_mm: float = Field(default=2.0, ge=0.0, le=50.0)
    gauge_std_mm: float = Field(default=0.0, ge=0.0, le=20.0)
    gauge_offset_mm: float = Field(default=0.0, ge=-20.0, le=40.0)
    curves: list[CurveTable] = Field(default_factory=list)

    @model_validator(mode="after")
    def _check_recipe(self) -> Self:
        if self.file is not None:
            for key in _RECIPE_KEYS:
                if key in self.model_fields_set:
                    raise field_error("cannot be given beside 'file'", key)
            return self
        if self.length_m is None:
            raise field_error("is missing", "length_m")
        if self.shortest_wavelength_m < 4.0 * self.interval_m:
            raise field_error(
                f"{self.shortest_wavelength_m:g} m is shorter than four intervals", "shortest_wavelength_m"
            )
        if not self.shortest_wavelength_m < self.longest_wavelength_m <= self.length_m:
            raise field_error(
                f"{self.longest_wavelength_m:g} m must be greater than {self.shortest_wavelength_m:g} m, "
                f"and at most the section's {self.length_m:g} m",
                "longest_wavelength_m",
            )
        return self

    @model_validator(mode="after")
    def _check_curves(self) -> Self:
        length = math.inf if self.length_m is None else self.length_m
        for index, curve in enumerate(self.curves):
            for key, value in (("start_m", curve.start_m), ("length_m", curve.length_m)):
                if value > length:
                    raise field_error(f"{value:g} m; the section has {length:g} m", "curves", index, key)
        return self

    def plan(self, folder: Path) -> SectionPlan:
        """Return the section in SI units.

        Parameters
        ----------
        folder
            Folder of the scenario file: a relative ``file`` starts here.
        """
        return SectionPlan(
            code=self.code,
            number=self.number,
            name=self.name,
            rail_profile=self.rail_profile,
            inclination=1.0 / self.rail_inclination_1_in,
            nominal_gauge=MM * self.nominal_gauge_mm,
            recipe=self._recipe(),
            file=None if self.file is None else folder / self.file,
            survey_alignment_std=MM * self.survey_alignment_std_mm,
            survey_gauge_std=MM * self.survey_gauge_std_mm,
            surveyed=self.surveyed,
            gauge_surveyed=self.gauge_surveyed,
            latitude=self.latitude_deg,
            longitude=self.longitude_deg,
        )

    def _recipe(self) -> TrackRecipe | None:
        if self.length_m is None:
            return None
        return TrackRecipe(
            length=self.length_m,
            interval=self.interval_m,
            alignment_std=MM * self.alignment_std_mm,
            gauge_std=MM * self.gauge_std_mm,
            gauge_offset=MM * self.gauge_offset_mm,
            wavelengths=(self.shortest_wavelength_m, self.longest_wavelength_m),
            curves=tuple(curve.plan() for curve in self.curves),
        )


_RECIPE_KEYS = (
    "length_m",
    "interval_m",
    "shortest_wavelength_m",
    "longest_wavelength_m",
    "alignment_std_mm",
    "gauge_std_mm",
    "gauge_offset_mm",
    "curves",
)


class SensorsTable(InputTable):
    """``[sensors]``."""

    kind: Text = "mems"
    rate_hz: Annotated[int, Field(ge=1, le=FULL_RATE_HZ), AfterValidator(_divides_full_rate)] = 250
    anti_alias: bool = True
    lateral_noise_ug_per_root_hz: NotNegative = 100.0
    lateral_offset_mg: NotNegative = 20.0
    lateral_drift_ug_per_root_s: NotNegative = 20.0
    lateral_limit_g: Positive = 50.0
    mass_noise_ug_per_root_hz: NotNegative = 100.0
    mass_offset_mg: NotNegative = 10.0
    mass_drift_ug_per_root_s: NotNegative = 20.0
    mass_limit_g: Positive = 2.0
    angular_noise_rad_s2_per_root_hz: NotNegative = 2e-3
    angular_offset_rad_s2: NotNegative = 0.05
    angular_drift_rad_s2_per_root_s: NotNegative = 2e-4
    angular_limit_rad_s2: Positive = 100.0

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        if self.kind not in ("mems", "ideal"):
            raise field_error(f"{self.kind!r} is neither 'mems' nor 'ideal'", "kind")
        if self.kind == "ideal":
            for key in self.model_fields_set - {"kind", "rate_hz"}:
                raise field_error("unknown key of ideal sensors; known here: kind, rate_hz", key)
        return self

    def plan(self) -> SensorNode:
        """Return the sensor node in SI units."""
        if self.kind == "ideal":
            return ideal_node(self.rate_hz)
        lateral = Channel(
            noise_density=MICRO_G * self.lateral_noise_ug_per_root_hz,
            offset=1e3 * MICRO_G * self.lateral_offset_mg,
            drift=MICRO_G * self.lateral_drift_ug_per_root_s,
            limit=1e6 * MICRO_G * self.lateral_limit_g,
        )
        mass = Channel(
            noise_density=MICRO_G * self.mass_noise_ug_per_root_hz,
            offset=1e3 * MICRO_G * self.mass_offset_mg,
            drift=MICRO_G * self.mass_drift_ug_per_root_s,
            limit=1e6 * MICRO_G * self.mass_limit_g,
        )
        angular = Channel(
            noise_density=self.angular_noise_rad_s2_per_root_hz,
            offset=self.angular_offset_rad_s2,
            drift=self.angular_drift_rad_s2_per_root_s,
            limit=self.angular_limit_rad_s2,
        )
        return SensorNode(lateral, angular, angular, mass, rate_hz=self.rate_hz, anti_alias=self.anti_alias)


class SpeedTable(InputTable):
    """``[speed]``."""

    lowest_m_s: float = Field(ge=2.0 * MINIMUM_SPEED)
    highest_m_s: float = Field(le=131.0)
    period_s: float = Field(default=120.0, ge=20.0)
    stop_every_s: NotNegative = 0.0
    stop_s: NotNegative = 30.0
    braking_m_s2: float = Field(default=0.5, gt=0.0, le=2.0)
    steady: bool = False

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.highest_m_s < self.lowest_m_s:
            raise field_error(f"{self.highest_m_s} is outside the range: at least {self.lowest_m_s:g}", "highest_m_s")
        return self

    def plan(self) -> SpeedRange:
        """Return the range of speeds, m/s."""
        return SpeedRange(
            lowest=self.lowest_m_s,
            highest=self.highest_m_s,
            period=self.period_s,
            steady=self.steady,
            stop_every=self.stop_every_s,
            stop=self.stop_s,
            braking=self.braking_m_s2,
        )


class SessionsTable(InputTable):
    """``[sessions]``."""

    start: Moment
    campaigns: int = Field(ge=1, le=10_000)
    minutes_each: float | None = Field(default=None, gt=0.0, le=600.0)
    whole_section: bool = False
    km_between: Positive
    first_odometer_km: NotNegative = 0.0
    km_per_day: Positive = 400.0
    start_within_m: NotNegative | None = None

    @model_validator(mode="after")
    def _check_length_of_runs(self) -> Self:
        if self.minutes_each is None and not self.whole_section:
            raise field_error("is missing", "minutes_each")
        for key in ("minutes_each", "start_within_m"):
            if self.whole_section and key in self.model_fields_set:
                raise field_error("cannot be given beside whole_section = true", key)
        return self

    def plan(self, longest_s: float) -> Sessions:
        """Return the campaigns in SI units, times in ns of the vehicle clock.

        Parameters
        ----------
        longest_s
            How long a run over the whole section takes at most, s.
        """
        return Sessions(
            start_ns=round(self.start.timestamp()) * 1_000_000_000,
            campaigns=self.campaigns,
            duration=longest_s if self.minutes_each is None else 60.0 * self.minutes_each,
            whole_section=self.whole_section,
            distance_between=KM * self.km_between,
            first_odometer=KM * self.first_odometer_km,
            distance_per_day=KM * self.km_per_day,
            start_within=math.inf if self.start_within_m is None else self.start_within_m,
        )


class PositionTable(InputTable):
    """``[position]``."""

    largest_offset_m: float = Field(default=0.0, ge=0.0, le=1000.0)
    largest_scale_percent: float = Field(default=0.0, ge=0.0, le=10.0)

    def plan(self) -> PositionErrors:
        """Return the position errors in SI units."""
        return PositionErrors(offset=self.largest_offset_m, scale=self.largest_scale_percent / 100.0)


class BusTable(InputTable):
    """``[bus]``."""

    lost_frames_percent: float = Field(default=0.0, ge=0.0, le=50.0)
    bursts_per_hour: float = Field(default=0.0, ge=0.0, le=3600.0)
    burst_s: float = Field(default=0.5, ge=0.0, le=60.0)
    jitter_us: float = Field(default=0.0, ge=0.0, le=1000.0)
    recorder_clock_offset_s: float = Field(default=0.0, ge=-86400.0, le=86400.0)

    def plan(self) -> BusPlan:
        """Return the errors of the bus in SI units."""
        return BusPlan(
            lost_share=self.lost_frames_percent / 100.0,
            burst_per_hour=self.bursts_per_hour,
            burst=self.burst_s,
            jitter=1e-6 * self.jitter_us,
            recorder_offset=self.recorder_clock_offset_s,
        )


class FaultTable(InputTable):
    """``[vehicles.wheelsets.fault]``."""

    kind: Annotated[Text, AfterValidator(_fault_kind)]
    from_campaign: int = Field(ge=1)

    def plan(self) -> Fault:
        """Return the fault."""
        return Fault(FaultKind(self.kind), self.from_campaign)


class WheelsetTable(InputTable):
    """``[[vehicles.wheelsets]]``."""

    serial: Text
    wheel_profile: WheelName = "P8"
    nominal_radius_mm: float = Field(default=450.0, ge=150.0, le=700.0)
    wear_mm_per_100000_km: float = Field(default=0.0, ge=0.0, le=20.0)
    wear_left_mm_per_100000_km: float | None = Field(default=None, ge=0.0, le=20.0)
    wear_right_mm_per_100000_km: float | None = Field(default=None, ge=0.0, le=20.0)
    wear_centre_mm: float | None = Field(default=None, ge=-30.0, le=30.0)
    wear_half_width_mm: float | None = Field(default=None, ge=5.0, le=100.0)
    flange_wear_share: float = Field(default=FLANGE_SHARE, ge=0.0, le=2.0)
    initial_wear_mm: float = Field(default=0.0, ge=0.0, le=5.0)
    initial_wear_left_mm: float | None = Field(default=None, ge=0.0, le=5.0)
    initial_wear_right_mm: float | None = Field(default=None, ge=0.0, le=5.0)
    initial_mileage_km: NotNegative = 0.0
    reprofiled_at_odometer_km: IncreasingNumbers = Field(default_factory=list)
    diameter_difference_mm: float = Field(default=0.0, ge=-5.0, le=5.0)
    fault: FaultTable | None = None

    def plan(self) -> WheelsetPlan:
        """Return the wheelset in SI units; where wear is not located, as measured on such wheels."""
        family = WearFamily.S1002_ON_60E1 if "1002" in self.wheel_profile else WearFamily.P8_ON_56E1
        course = wear_course(family, 0.0)
        left, right = (
            self.wear_mm_per_100000_km if rate is None else rate
            for rate in (self.wear_left_mm_per_100000_km, self.wear_right_mm_per_100000_km)
        )
        initial_left, initial_right = (
            self.initial_wear_mm if depth is None else depth
            for depth in (self.initial_wear_left_mm, self.initial_wear_right_mm)
        )
        centre, half_width = self.wear_centre_mm, self.wear_half_width_mm
        per_metre = MM / (1e5 * KM)
        return WheelsetPlan(
            serial=self.serial,
            wheel_profile=self.wheel_profile,
            nominal_radius=MM * self.nominal_radius_mm,
            rate_left=per_metre * left,
            rate_right=per_metre * right,
            wear_centre=MM * (course.centre / MM if centre is None else centre),
            wear_half_width=MM * (course.half_width / MM if half_width is None else half_width),
            flange_share=self.flange_wear_share,
            initial_left=MM * initial_left,
            initial_right=MM * initial_right,
            initial_mileage=KM * self.initial_mileage_km,
            reprofilings=tuple(KM * value for value in self.reprofiled_at_odometer_km),
            diameter_difference=MM * self.diameter_difference_mm,
            fault=None if self.fault is None else self.fault.plan(),
        )


class VehicleTable(InputTable):
    """``[[vehicles]]``."""

    code: Text
    vehicle_class: Text = Field(alias="class")
    max_speed_km_h: float = Field(gt=0.0, le=400.0)
    axle_offsets_m: IncreasingNumbers | None = None
    wheelsets: list[WheelsetTable] = Field(min_length=1, max_length=MAX_AXLES)

    @model_validator(mode="after")
    def _check_offsets(self) -> Self:
        offsets = self.axle_offsets_m
        if offsets is not None and len(offsets) != len(self.wheelsets):
            raise field_error(f"{len(offsets)} offsets for {len(self.wheelsets)} wheelsets", "axle_offsets_m")
        return self

    def plan(self) -> VehiclePlan:
        """Return the vehicle in SI units."""
        default = [DEFAULT_AXLE_SPACING * axle for axle in range(len(self.wheelsets))]
        return VehiclePlan(
            code=self.code,
            vehicle_class=self.vehicle_class,
            max_speed=KM_PER_HOUR * self.max_speed_km_h,
            axle_offsets=tuple(default if self.axle_offsets_m is None else self.axle_offsets_m),
            wheelsets=tuple(wheelset.plan() for wheelset in self.wheelsets),
        )


class PairTable(InputTable):
    """``[[drawn_fleet.pairs]]``."""

    name: Text
    wheel_profile: WheelName
    rail_profile: RailName
    rail_inclination_1_in: float = Field(default=20.0, ge=5.0)
    deepest_wear_mm: float = Field(ge=0.0, le=5.0)

    def plan(self) -> ProfilePair:
        """Return the pair in SI units."""
        return ProfilePair(
            name=self.name,
            wheel_profile=self.wheel_profile,
            rail_profile=self.rail_profile,
            inclination=1.0 / self.rail_inclination_1_in,
            deepest_wear=MM * self.deepest_wear_mm,
        )


class DrawnFleetTable(InputTable):
    """``[drawn_fleet]``: stands in for ``[[vehicles]]``."""

    vehicles: int = Field(default=4, ge=1, le=64)
    wheelsets_each: int = Field(default=4, ge=1, le=MAX_AXLES)
    wear_alike: bool = False
    profiles_measured: int = Field(default=0, ge=0, le=512)
    vehicle_class: Text = Field(default="multiple unit", alias="class")
    max_speed_km_h: float = Field(default=120.0, gt=0.0, le=400.0)
    pairs: list[PairTable] = Field(min_length=1)

    def plan(self) -> DrawnFleet:
        """Return the fleet in SI units."""
        return DrawnFleet(
            pairs=tuple(pair.plan() for pair in self.pairs),
            vehicles=self.vehicles,
            wheelsets=self.wheelsets_each,
            wear_alike=self.wear_alike,
            profiles_measured=self.profiles_measured,
            vehicle_class=self.vehicle_class,
            max_speed=KM_PER_HOUR * self.max_speed_km_h,
        )


class VehicleErrorsTable(InputTable):
    """``[vehicle_errors]``."""

    creep_percent: float = Field(default=20.0, ge=0.0, le=50.0)
    stiffness_percent: float = Field(default=10.0, ge=0.0, le=50.0)
    mass_percent: float = Field(default=5.0, ge=0.0, le=50.0)

    def plan(self) -> VehicleErrors:
        """Return the limits as shares."""
        return VehicleErrors(self.creep_percent / 100.0, self.stiffness_percent / 100.0, self.mass_percent / 100.0)
