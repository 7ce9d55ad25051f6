"""The tables of vehicles: parameters of wheelsets and bogies, and the wheelsets of a fleet that is listed."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Self

from annotated_types import Interval, Len

from estimation.contact.wear import WearFamily, wear_course
from estimation.values.fields import KM, KM_H, MM, FileUnit, Key
from estimation.values.registry import MAX_AXLES
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, GRAVITY, Arrangement, BogieParameters, VehicleParameters
from ingest.file_value import FileBeside, IncreasingPlaces, Inline, between, taken
from ingest.input_file import NotNegative, Positive, Text, field_error
from ingest.simulator.scenario import Fault, VehiclePlan, WeakDamper, WheelsetPlan, usual_offsets
from ingest.simulator.section import WheelName

ROUNDING = 1e-3  # m, of axle offsets
FLANGE_SHARE = 0.6
Rate = Annotated[float, between(0.0, 20.0), FileUnit("_mm_per_100000_km", 1e-3 / 1e8)]
Wear = Annotated[float, between(0.0, 5.0), MM]


def impossible_bogies(offsets: Sequence[float], wheelbase: float) -> str | None:
    """Return why axles at ``offsets`` are not in bogies of ``wheelbase``, both m; None where they are."""
    if len(offsets) % AXLES_OF_A_BOGIE:
        return f"{len(offsets)} wheelsets, bogies have two each"
    for front, rear in zip(offsets[::2], offsets[1::2], strict=True):
        if abs(rear - front - wheelbase) > ROUNDING:
            return f"axles at {front:g} and {rear:g} m are not {wheelbase:g} m apart, the wheelbase of their bogie"
    return None


@dataclass(frozen=True, slots=True)
class DynamicsTable:
    """``[dynamics]``: parameters of the vehicle by their names, in SI units.

    Where the table has none, the load is the whole axle load, and the suspended mass of a wheelset in a bogie half of
    what is above both.
    """

    parameters: Annotated[VehicleParameters, Inline(VehicleParameters)] = field(
        default_factory=lambda: replace(VehicleParameters(), load=VehicleParameters().axle_load)
    )
    arrangement: Arrangement = Arrangement.SINGLE_WHEELSET
    bogie: BogieParameters | None = None

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse bogies without parameters, and the reverse."""
        wanted = self.arrangement is Arrangement.BOGIE
        if wanted and self.bogie is None:
            raise field_error("is missing; the arrangement needs it", "bogie")
        if not wanted and self.bogie is not None:
            raise field_error(f"arrangement = {str(Arrangement.BOGIE)!r} is needed beside it", "bogie")
        parameters = self.parameters
        if self.bogie is None:
            load = parameters.axle_load
        else:
            above = (self.bogie.frame_mass + self.bogie.body_mass) / AXLES_OF_A_BOGIE
            load = (parameters.wheelset_mass + above) * GRAVITY
            if "suspended_mass" not in given:
                parameters = replace(parameters, suspended_mass=above)
        return replace(self, parameters=parameters if "load" in given else replace(parameters, load=load))


@dataclass(frozen=True, slots=True)
class WheelsetTable:
    """``[[vehicles.wheelsets]]``."""

    serial: Text
    wheel_profile: WheelName = "P8"
    nominal_radius: Annotated[float, between(150.0, 700.0), MM] | None = None
    wear: Rate = 0.0
    wear_left: Rate | None = None
    wear_right: Rate | None = None
    wear_centre: Annotated[float, between(-30.0, 30.0), MM] | None = None
    wear_half_width: Annotated[float, between(5.0, 100.0), MM] | None = None
    flange_wear_share: Annotated[float, between(0.0, 2.0)] = FLANGE_SHARE
    initial_wear: Wear = 0.0
    initial_wear_left: Wear | None = None
    initial_wear_right: Wear | None = None
    initial_mileage: Annotated[NotNegative, KM] = 0.0
    reprofiled: Annotated[IncreasingPlaces, Key("reprofiled_at_odometer_km")] = ()  # km
    reprofilings_registered: bool = True
    diameter_difference: Annotated[float, between(-5.0, 5.0), MM] = 0.0
    wheel_file: FileBeside | None = None
    wheel_left_file: FileBeside | None = None
    wheel_right_file: FileBeside | None = None
    fault: Fault | None = None

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse two files of one wheel."""
        if self.wheel_file is not None and (self.wheel_left_file, self.wheel_right_file) != (None, None):
            raise field_error("cannot be given beside the files of one side", "wheel_file")
        return self

    def wheels_to_read(self) -> Iterator[tuple[str, Path]]:
        """Yield key and path of the files that are given."""
        for key in ("wheel_file", "wheel_left_file", "wheel_right_file"):
            if (path := getattr(self, key)) is not None:
                yield key, path

    def plan(self, radius: float) -> WheelsetPlan:
        """Return the wheelset; where wear is not located, as measured on such wheels."""
        course = wear_course(WearFamily.S1002_ON_60E1 if "1002" in self.wheel_profile else WearFamily.P8_ON_56E1, 0.0)
        centre, half_width = self.wear_centre, self.wear_half_width
        initial_left, initial_right = self.initial_wear_left, self.initial_wear_right
        return taken(
            WheelsetPlan,
            self,
            nominal_radius=radius if self.nominal_radius is None else self.nominal_radius,
            rate_left=self.wear if self.wear_left is None else self.wear_left,
            rate_right=self.wear if self.wear_right is None else self.wear_right,
            wear_centre=1e-3 * (course.centre / 1e-3) if centre is None else centre,
            wear_half_width=1e-3 * (course.half_width / 1e-3) if half_width is None else half_width,
            flange_share=self.flange_wear_share,
            initial_left=self.initial_wear if initial_left is None else initial_left,
            initial_right=self.initial_wear if initial_right is None else initial_right,
            reprofilings=tuple(1e3 * odometer_km for odometer_km in self.reprofiled),
            wheel_files=(self.wheel_file or self.wheel_left_file, self.wheel_file or self.wheel_right_file),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class VehicleTable:
    """``[[vehicles]]``."""

    code: Text
    vehicle_class: Annotated[Text, Key("class")]
    max_speed: Annotated[float, Interval(gt=0.0, le=400.0), KM_H]
    axle_offsets: Annotated[IncreasingPlaces, Key("axle_offsets_m")] | None = None
    longest_run: Annotated[Positive, FileUnit("", 60.0), Key("minutes_each")] = math.inf
    wheelsets: Annotated[tuple[WheelsetTable, ...], Len(1, MAX_AXLES)]
    weak_damper: WeakDamper | None = None

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse another number of offsets than of wheelsets."""
        offsets = self.axle_offsets
        if offsets is not None and len(offsets) != len(self.wheelsets):
            raise field_error(f"{len(offsets)} offsets for {len(self.wheelsets)} wheelsets", "axle_offsets_m")
        return self

    def offsets(self, bogie: BogieParameters | None) -> tuple[float, ...]:
        """Return the distances of the axles behind the position reference, m."""
        return usual_offsets(len(self.wheelsets), bogie) if self.axle_offsets is None else self.axle_offsets

    def plan(self, radius: float, bogie: BogieParameters | None) -> VehiclePlan:
        """Return the vehicle."""
        wheelsets = tuple(wheelset.plan(radius) for wheelset in self.wheelsets)
        return taken(VehiclePlan, self, axle_offsets=self.offsets(bogie), wheelsets=wheelsets)
