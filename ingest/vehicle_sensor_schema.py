"""Schema of the sensors of a vehicle class."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from estimation.vehicle.vehicle_class import SensorChannel, SensorLayout
from ingest.input_file import InputTable, field_error


class SensorTable(InputTable):
    """One sensor. Noise density and range have the unit of the kind."""

    kind: Literal["accelerometer", "angular_accelerometer", "gyroscope"]
    place: Literal["axle_box", "frame", "mass"]
    axis: Literal["x", "y", "z"]
    noise_density_m_s2_rthz: Annotated[float, Field(ge=0.0, le=0.1)] | None = None
    range_m_s2: Annotated[float, Field(ge=1.0, le=2e4)] | None = None
    noise_density_rad_s2_rthz: Annotated[float, Field(ge=0.0, le=1.0)] | None = None
    range_rad_s2: Annotated[float, Field(ge=0.5, le=2e4)] | None = None
    noise_density_rad_s_rthz: Annotated[float, Field(ge=0.0, le=0.05)] | None = None
    range_rad_s: Annotated[float, Field(ge=0.1, le=100.0)] | None = None
    scale_std: Annotated[float, Field(ge=0.0, le=0.5)] = 0.01  # relative; the default is that of usual sensors

    @model_validator(mode="after")
    def _check_units(self) -> Self:
        unit = _UNITS[self.kind]
        if getattr(self, f"noise_density_{unit}_rthz") is None:
            raise field_error("is missing", f"noise_density_{unit}_rthz")
        for name in self.model_fields_set - {"kind", "place", "axis", "scale_std"}:
            if name not in {f"noise_density_{unit}_rthz", f"range_{unit}"}:
                raise field_error(f"is not the unit of kind = {self.kind!r}", name)
        return self

    def channel(self) -> SensorChannel:
        """Return the sensor in SI units."""
        unit = _UNITS[self.kind]
        limit = getattr(self, f"range_{unit}")
        noise = getattr(self, f"noise_density_{unit}_rthz")
        return SensorChannel(noise, self.scale_std, math.inf if limit is None else limit)


_UNITS: Mapping[str, str] = {"accelerometer": "m_s2", "angular_accelerometer": "rad_s2", "gyroscope": "rad_s"}
_AXES: Mapping[str, str] = {"lateral": "y", "yaw": "z", "roll": "x", "mass_lateral": "y"}
_MOMENTS: Mapping[str, str] = {
    "lateral": "the lateral acceleration of the wheelset",
    "yaw": "the yaw of the wheelset, and with it the moment of its suspension and rL - rR,",
    "roll": "the roll of the wheelset, and with it gravity in the lateral signal,",
    "mass_lateral": "the lateral acceleration above the axle, and with it the force of the suspension and the yaw of"
    " a bogie frame,",
}


class SensorsTable(InputTable):
    """``sensors``: those of one node."""

    rate_hz: Annotated[float, Field(ge=20.0, le=20_000.0)]
    measures_gravity: bool = True
    lateral: SensorTable | None = None
    yaw: SensorTable | None = None
    roll: SensorTable | None = None
    mass_lateral: SensorTable | None = None

    @model_validator(mode="after")
    def _check_layout(self) -> Self:
        for name, axis in _AXES.items():
            sensor: SensorTable | None = getattr(self, name)
            if sensor is None:
                raise field_error(f"{_MOMENTS[name]} is not measured: nothing is estimated without it", name)
            if sensor.axis != axis:
                raise field_error(f"must be {axis!r}; signs belong to the bus", name, "axis")
            if (sensor.kind == "accelerometer") != (axis == "y"):
                raise field_error(f"{sensor.kind!r} does not measure {_MOMENTS[name].partition(',')[0]}", name, "kind")
            if (sensor.place == "axle_box") != (name != "mass_lateral"):
                places = "'frame' or 'mass'" if name == "mass_lateral" else "'axle_box'"
                raise field_error(f"{_MOMENTS[name].partition(',')[0]} is measured at {places}", name, "place")
        return self

    def layout(self) -> SensorLayout:
        """Return the sensors in SI units."""
        sensors = {name: getattr(self, name) for name in _AXES}
        return SensorLayout(
            **{name: sensor.channel() for name, sensor in sensors.items()},
            yaw_is_gyroscope=sensors["yaw"].kind == "gyroscope",
            roll_is_gyroscope=sensors["roll"].kind == "gyroscope",
            measures_gravity=self.measures_gravity,
            rate_hz=self.rate_hz,
        )
