"""The fleet: vehicles with their wheelsets, wear and faults, listed or drawn; parameters and their errors."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from estimation.contact.wear import WearFamily, wear_course
from estimation.errors import ParameterError
from estimation.vehicle.equations_of_motion import VehicleParameters
from ingest.input_file import IncreasingNumbers, InputTable, NotNegative, Text, field_error
from ingest.simulator.scenario import (
    DrawnFleet,
    Fault,
    FaultKind,
    ProfilePair,
    VehicleErrors,
    VehiclePlan,
    WheelsetPlan,
)
from ingest.simulator.scenario_schema.profile_names import RailName, WheelName
from ingest.simulator.scenario_schema.units import KM, KM_PER_HOUR, MM

MAX_AXLES = 8
DEFAULT_AXLE_SPACING = 2.6  # m
FLANGE_SHARE = 0.6


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


class FleetTable(InputTable):
    """``[fleet]``."""

    code: Text
    name: Text


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
