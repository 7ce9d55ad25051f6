"""The fleet: vehicles with their wheelsets, wear and faults, as listed."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from estimation.contact.wear import WearFamily, wear_course
from estimation.vehicle.vehicle_class import BogieParameters
from ingest.input_file import IncreasingNumbers, InputTable, NotNegative, Text, field_error
from ingest.simulator.scenario import (
    Fault,
    FaultKind,
    SideFiles,
    VehiclePlan,
    WeakDamper,
    WheelsetPlan,
    usual_offsets,
)
from ingest.simulator.scenario_schema.drawn_fleet import MAX_AXLES
from ingest.simulator.scenario_schema.profile_names import WheelName
from ingest.simulator.scenario_schema.units import KM, KM_PER_HOUR, MM

FLANGE_SHARE = 0.6


def _fault_kind(kind: str) -> str:
    if kind not in tuple(FaultKind):
        raise field_error(f"{kind!r} is none of {', '.join(FaultKind)}")
    return kind


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
    nominal_radius_mm: float | None = Field(default=None, ge=150.0, le=700.0)
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
    reprofilings_registered: bool = True
    diameter_difference_mm: float = Field(default=0.0, ge=-5.0, le=5.0)
    wheel_file: Text | None = None
    wheel_left_file: Text | None = None
    wheel_right_file: Text | None = None
    fault: FaultTable | None = None

    @model_validator(mode="after")
    def _check_wheel_files(self) -> Self:
        if self.wheel_file is not None and (self.wheel_left_file, self.wheel_right_file) != (None, None):
            raise field_error("cannot be given beside the files of one side", "wheel_file")
        return self

    def wheel_names(self) -> list[tuple[str, str]]:
        """Return keys and names of the files that are given."""
        named = {
            "wheel_file": self.wheel_file,
            "wheel_left_file": self.wheel_left_file,
            "wheel_right_file": self.wheel_right_file,
        }
        return [(key, name) for key, name in named.items() if name is not None]

    def _files(self, folder: Path) -> SideFiles:
        left, right = (self.wheel_file or side for side in (self.wheel_left_file, self.wheel_right_file))
        return None if left is None else folder / left, None if right is None else folder / right

    def plan(self, folder: Path, radius: float) -> WheelsetPlan:
        """Return the wheelset in SI units; where wear is not located, as measured on such wheels.

        Args:
            folder: Folder of the scenario file: relative file names start here.
            radius: Nominal rolling radius where the table has none, m.
        """
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
            nominal_radius=radius if self.nominal_radius_mm is None else MM * self.nominal_radius_mm,
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
            wheel_files=self._files(folder),
            reprofilings_registered=self.reprofilings_registered,
        )


class WeakDamperTable(InputTable):
    """``[vehicles.weak_damper]``."""

    share: float = Field(ge=0.0, le=2.0)
    from_campaign: int = Field(default=1, ge=1)
    running_gear: int | None = Field(default=None, ge=1)

    def plan(self) -> WeakDamper:
        """Return the damper."""
        return WeakDamper(self.share, self.from_campaign, self.running_gear)


class VehicleTable(InputTable):
    """``[[vehicles]]``."""

    code: Text
    vehicle_class: Text = Field(alias="class")
    max_speed_km_h: float = Field(gt=0.0, le=400.0)
    axle_offsets_m: IncreasingNumbers | None = None
    minutes_each: float | None = Field(default=None, gt=0.0)
    wheelsets: list[WheelsetTable] = Field(min_length=1, max_length=MAX_AXLES)
    weak_damper: WeakDamperTable | None = None

    @model_validator(mode="after")
    def _check_offsets(self) -> Self:
        offsets = self.axle_offsets_m
        if offsets is not None and len(offsets) != len(self.wheelsets):
            raise field_error(f"{len(offsets)} offsets for {len(self.wheelsets)} wheelsets", "axle_offsets_m")
        return self

    def offsets(self, bogie: BogieParameters | None) -> tuple[float, ...]:
        """Return the distances of the axles behind the position reference, m."""
        if self.axle_offsets_m is None:
            return usual_offsets(len(self.wheelsets), bogie)
        return tuple(self.axle_offsets_m)

    def plan(self, folder: Path, radius: float, bogie: BogieParameters | None) -> VehiclePlan:
        """Return the vehicle in SI units.

        Args:
            folder: Folder of the scenario file: relative file names start here.
            radius: Nominal rolling radius of wheelsets that have none of their own, m.
        """
        return VehiclePlan(
            code=self.code,
            vehicle_class=self.vehicle_class,
            max_speed=KM_PER_HOUR * self.max_speed_km_h,
            axle_offsets=self.offsets(bogie),
            wheelsets=tuple(wheelset.plan(folder, radius) for wheelset in self.wheelsets),
            longest_run=math.inf if self.minutes_each is None else 60.0 * self.minutes_each,
            weak_damper=None if self.weak_damper is None else self.weak_damper.plan(),
        )
