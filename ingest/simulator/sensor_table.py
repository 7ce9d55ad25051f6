"""The sensors of a scenario, as its file has them."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import Annotated, Self

from pydantic import AfterValidator

from estimation.values.file_units import MS, PERCENT, FileUnit, Key
from ingest.file_value import between
from ingest.input_file import NotNegative, Positive, Text, field_error
from ingest.simulator.sensor_errors import SensorErrors, Vibration
from ingest.simulator.sensors import FULL_RATE_HZ, Channel, SensorNode, ideal_node

MICRO_G = 9.80665e-6  # m/s2
UG, MG, G = FileUnit("_ug", MICRO_G), FileUnit("_mg", 1e3 * MICRO_G), FileUnit("_g", 1e6 * MICRO_G)
Noise = Annotated[NotNegative, FileUnit("_ug_per_root_hz", MICRO_G)]
Drift = Annotated[NotNegative, FileUnit("_ug_per_root_s", MICRO_G)]
RAD_S2 = FileUnit("_rad_s2")


def _divides_full_rate(rate: int) -> int:
    if FULL_RATE_HZ % rate:
        raise field_error(f"{rate} Hz does not divide {FULL_RATE_HZ} Hz")
    return rate


@dataclass(frozen=True, slots=True)
class SensorsTable:
    """``[sensors]``."""

    kind: Text = "mems"
    rate_hz: Annotated[int, between(1, FULL_RATE_HZ), AfterValidator(_divides_full_rate)] = 250
    anti_alias: bool = True
    lateral_noise: Noise = MICRO_G * 100.0
    lateral_offset: Annotated[NotNegative, MG] = 1e3 * MICRO_G * 20.0
    lateral_drift: Drift = MICRO_G * 20.0
    lateral_limit: Annotated[Positive, G] = 1e6 * MICRO_G * 50.0
    mass_noise: Noise = MICRO_G * 100.0
    mass_offset: Annotated[NotNegative, MG] = 1e3 * MICRO_G * 10.0
    mass_drift: Drift = MICRO_G * 20.0
    mass_limit: Annotated[Positive, G] = 1e6 * MICRO_G * 2.0
    angular_noise: Annotated[NotNegative, FileUnit("_rad_s2_per_root_hz")] = 2e-3
    angular_offset: Annotated[NotNegative, RAD_S2] = 0.05
    angular_drift: Annotated[NotNegative, FileUnit("_rad_s2_per_root_s")] = 2e-4
    angular_limit: Annotated[Positive, RAD_S2] = 100.0
    gyroscopes: bool = False
    gyroscope_noise: Annotated[NotNegative, FileUnit("_rad_s_per_root_hz")] = 1e-4
    gyroscope_limit: Annotated[Positive, FileUnit("_rad_s")] = 8.7
    measures_gravity: bool = False
    mass_sensor: bool = True
    scale_error_std: Annotated[float, between(0.0, 30.0), PERCENT] = 0.0
    mounting_error_std: Annotated[float, between(0.0, 20.0), AfterValidator(math.radians), FileUnit("_deg")] = 0.0
    skew_std: Annotated[float, between(0.0, 100.0), MS] = 0.0
    offset_drift_std: Annotated[NotNegative, FileUnit("_mg_per_min", 1e3 * MICRO_G, 60.0)] = 0.0
    angular_offset_drift_std: Annotated[NotNegative, FileUnit("_rad_s2_per_min", divisor=60.0)] = 0.0
    scale_drift_std: Annotated[float, between(0.0, 30.0), PERCENT] = 0.0
    axle_box_vibration: Annotated[NotNegative, FileUnit("_m_s2")] = 0.0
    axle_box_angular_vibration: Annotated[NotNegative, Key("axle_box_vibration_rad_s2")] = 0.0
    mass_vibration_share: Annotated[float, between(0.0, 1.0)] = 0.1
    vibration_from_hz: Annotated[float, between(1.0, 450.0)] = 20.0
    vibration_to_hz: Annotated[float, between(2.0, 480.0)] = 400.0

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse a band without frequencies, and errors of ideal sensors."""
        if self.vibration_from_hz >= self.vibration_to_hz:
            raise field_error("must be below 'vibration_to_hz'", "vibration_from_hz")
        if self.kind not in {"mems", "ideal"}:
            raise field_error(f"{self.kind!r} is neither 'mems' nor 'ideal'", "kind")
        if self.kind == "ideal":
            for key in set(given) - {"kind", "rate_hz"}:
                raise field_error("unknown key of ideal sensors; known here: kind, rate_hz", key)
        return self

    def plan(self) -> SensorNode:
        """Return the sensor node."""
        if self.kind == "ideal":
            return ideal_node(self.rate_hz)
        angular = Channel(self.angular_noise, self.angular_offset, self.angular_drift, self.angular_limit)
        if self.gyroscopes:
            angular = Channel(self.gyroscope_noise, limit=self.gyroscope_limit, gyroscope=True)
        return SensorNode(
            Channel(self.lateral_noise, self.lateral_offset, self.lateral_drift, self.lateral_limit),
            angular,
            angular,
            Channel(self.mass_noise, self.mass_offset, self.mass_drift, self.mass_limit),
            rate_hz=self.rate_hz,
            anti_alias=self.anti_alias,
            errors=self._errors(),
            measures_gravity=self.measures_gravity,
            on_mass=self.mass_sensor,
        )

    def _errors(self) -> SensorErrors:
        linear, angular = self.offset_drift_std, 0.0 if self.gyroscopes else self.angular_offset_drift_std
        vibrates = self.axle_box_vibration > 0.0 or self.axle_box_angular_vibration > 0.0
        vibration = Vibration(
            self.axle_box_vibration,
            self.axle_box_angular_vibration,
            self.mass_vibration_share,
            self.vibration_from_hz,
            self.vibration_to_hz,
        )
        return SensorErrors(
            scale=self.scale_error_std,
            mounting=self.mounting_error_std,
            skew=self.skew_std,
            offset_slope=(linear, angular, angular, linear),
            scale_drift=self.scale_drift_std,
            vibration=vibration if vibrates else None,
        )
