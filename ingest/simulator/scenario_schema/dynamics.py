"""The vehicles: parameters of their wheelsets, bogies, and how far they are from all that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, model_validator

from estimation.errors import ParameterError
from estimation.vehicle.equations_of_motion import GRAVITY, VehicleParameters
from estimation.vehicle.vehicle_class import AXLES_OF_A_BOGIE, Arrangement, BogieParameters
from ingest.input_file import InputTable, NotNegative, Positive, Text, field_error
from ingest.simulator.scenario import VehicleErrors

ROUNDING = 1e-3  # m, of axle offsets


def _arrangement(text: str) -> str:
    if text not in tuple(Arrangement):
        raise field_error(f"{text!r} is none of {', '.join(Arrangement)}")
    return text


def impossible_bogies(offsets: Sequence[float], wheelbase: float) -> str | None:
    """Return why axles at ``offsets`` are not in bogies of ``wheelbase``, both m; None where they are.

    Args:
        wheelbase: Of every bogie.
    """
    if len(offsets) % AXLES_OF_A_BOGIE:
        return f"{len(offsets)} wheelsets, bogies have two each"
    for front, rear in zip(offsets[::2], offsets[1::2], strict=True):
        if abs(rear - front - wheelbase) > ROUNDING:
            return f"axles at {front:g} and {rear:g} m are not {wheelbase:g} m apart, the wheelbase of their bogie"
    return None


class BogieTable(InputTable):
    """``[dynamics.bogie]``: a bogie and what it carries, in SI units."""

    wheelbase: Annotated[float, Field(ge=0.5, le=10.0)]
    frame_mass: Positive
    frame_yaw_inertia: Positive
    body_mass: Positive
    secondary_lateral_stiffness: NotNegative = 0.0
    secondary_lateral_damping: NotNegative = 0.0
    secondary_yaw_stiffness: NotNegative = 0.0
    secondary_yaw_damping: NotNegative = 0.0

    def plan(self) -> BogieParameters:
        """Return the parameters."""
        return BogieParameters(**self.model_dump())


class DynamicsTable(InputTable):
    """``[dynamics]``: parameters of the vehicle by their names, in SI units."""

    longitudinal_creep_coefficient: NotNegative | None = None
    lateral_creep_coefficient: NotNegative | None = None
    lateral_spin_creep_coefficient: NotNegative | None = None
    spin_creep_coefficient: NotNegative | None = None
    lateral_damping: NotNegative | None = None
    yaw_damping: NotNegative | None = None
    yaw_inertia: NotNegative | None = None
    pitch_inertia: NotNegative | None = None
    half_contact_distance: NotNegative | None = None
    wheelset_mass: NotNegative | None = None
    suspended_mass: NotNegative | None = None
    lateral_stiffness: NotNegative | None = None
    yaw_stiffness: NotNegative | None = None
    load: NotNegative | None = None
    nominal_radius: NotNegative | None = None
    arrangement: Annotated[Text, AfterValidator(_arrangement)] = str(Arrangement.SINGLE_WHEELSET)
    bogie: BogieTable | None = None

    @model_validator(mode="after")
    def _check_parameters(self) -> Self:
        try:
            VehicleParameters(**self._given())
        except ParameterError as error:
            raise field_error(error.reason, *([error.field] if error.field else [])) from error
        return self

    @model_validator(mode="after")
    def _check_bogie(self) -> Self:
        wanted = self.arrangement == Arrangement.BOGIE
        if wanted and self.bogie is None:
            raise field_error("is missing; the arrangement needs it", "bogie")
        if not wanted and self.bogie is not None:
            raise field_error(f"arrangement = {str(Arrangement.BOGIE)!r} is needed beside it", "bogie")
        return self

    def _given(self) -> dict[str, Any]:
        return self.model_dump(exclude_none=True, exclude={"arrangement", "bogie"})

    def parameters(self) -> VehicleParameters:
        """Return the parameters of a wheelset.

        Where the table has none, the load is the whole axle load, and the suspended mass of a wheelset in a bogie half
        of what is above both.
        """
        given = self._given()
        if self.bogie is not None:
            given.setdefault("suspended_mass", (self.bogie.frame_mass + self.bogie.body_mass) / AXLES_OF_A_BOGIE)
        parameters = VehicleParameters(**given)
        if "load" in given:
            return parameters
        if self.bogie is None:
            return replace(parameters, load=parameters.axle_load)
        above = (self.bogie.frame_mass + self.bogie.body_mass) / AXLES_OF_A_BOGIE
        return replace(parameters, load=(parameters.wheelset_mass + above) * GRAVITY)

    def bogie_plan(self) -> BogieParameters | None:
        """Return the bogies of the vehicles; None for single wheelsets."""
        return None if self.bogie is None else self.bogie.plan()


class VehicleErrorsTable(InputTable):
    """``[vehicle_errors]``."""

    creep_percent: float = Field(default=20.0, ge=0.0, le=50.0)
    stiffness_percent: float = Field(default=10.0, ge=0.0, le=50.0)
    mass_percent: float = Field(default=5.0, ge=0.0, le=50.0)

    def plan(self) -> VehicleErrors:
        """Return the limits as shares."""
        return VehicleErrors(self.creep_percent / 100.0, self.stiffness_percent / 100.0, self.mass_percent / 100.0)
