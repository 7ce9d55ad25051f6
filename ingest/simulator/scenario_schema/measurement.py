"""What is measured and sent, with its errors: sensors, positions, bus."""

from __future__ import annotations

import math
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from ingest.input_file import InputTable, NotNegative, Positive, Text, field_error
from ingest.simulator.scenario import BusPlan, PositionErrors
from ingest.simulator.scenario_schema.units import MICRO_G
from ingest.simulator.sensor_errors import SensorErrors, Vibration
from ingest.simulator.sensors import FULL_RATE_HZ, Channel, SensorNode, ideal_node

MINUTE = 60.0  # s


def _divides_full_rate(rate: int) -> int:
    if FULL_RATE_HZ % rate:
        raise field_error(f"{rate} Hz does not divide {FULL_RATE_HZ} Hz")
    return rate


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
    gyroscopes: bool = False
    gyroscope_noise_rad_s_per_root_hz: NotNegative = 1e-4
    gyroscope_limit_rad_s: Positive = 8.7
    measures_gravity: bool = False
    mass_sensor: bool = True
    scale_error_std_percent: float = Field(default=0.0, ge=0.0, le=30.0)
    mounting_error_std_deg: float = Field(default=0.0, ge=0.0, le=20.0)
    skew_std_ms: float = Field(default=0.0, ge=0.0, le=100.0)
    offset_drift_std_mg_per_min: NotNegative = 0.0
    angular_offset_drift_std_rad_s2_per_min: NotNegative = 0.0
    scale_drift_std_percent: float = Field(default=0.0, ge=0.0, le=30.0)
    axle_box_vibration_m_s2: NotNegative = 0.0
    axle_box_vibration_rad_s2: NotNegative = 0.0
    mass_vibration_share: float = Field(default=0.1, ge=0.0, le=1.0)
    vibration_from_hz: float = Field(default=20.0, ge=1.0, le=450.0)
    vibration_to_hz: float = Field(default=400.0, ge=2.0, le=480.0)

    @model_validator(mode="after")
    def _check_vibration(self) -> Self:
        if self.vibration_from_hz >= self.vibration_to_hz:
            raise field_error("must be below 'vibration_to_hz'", "vibration_from_hz")
        return self

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
        if self.gyroscopes:
            angular = Channel(
                noise_density=self.gyroscope_noise_rad_s_per_root_hz, limit=self.gyroscope_limit_rad_s, gyroscope=True
            )
        return SensorNode(
            lateral,
            angular,
            angular,
            mass,
            rate_hz=self.rate_hz,
            anti_alias=self.anti_alias,
            errors=self._errors(),
            measures_gravity=self.measures_gravity,
            on_mass=self.mass_sensor,
        )

    def _errors(self) -> SensorErrors:
        linear = 1e3 * MICRO_G * self.offset_drift_std_mg_per_min / MINUTE
        angular = 0.0 if self.gyroscopes else self.angular_offset_drift_std_rad_s2_per_min / MINUTE
        vibrates = self.axle_box_vibration_m_s2 > 0.0 or self.axle_box_vibration_rad_s2 > 0.0
        vibration = Vibration(
            lateral=self.axle_box_vibration_m_s2,
            angular=self.axle_box_vibration_rad_s2,
            mass_share=self.mass_vibration_share,
            lowest_hz=self.vibration_from_hz,
            highest_hz=self.vibration_to_hz,
        )
        return SensorErrors(
            scale=self.scale_error_std_percent / 100.0,
            mounting=math.radians(self.mounting_error_std_deg),
            skew=1e-3 * self.skew_std_ms,
            offset_slope=(linear, angular, angular, linear),
            scale_drift=self.scale_drift_std_percent / 100.0,
            vibration=vibration if vibrates else None,
        )


class PositionTable(InputTable):
    """``[position]``."""

    largest_offset_m: float = Field(default=0.0, ge=0.0, le=1000.0)
    largest_scale_percent: float = Field(default=0.0, ge=0.0, le=10.0)
    offset_std_m: float = Field(default=0.0, ge=0.0, le=300.0)
    scale_std_percent: float = Field(default=0.0, ge=0.0, le=3.0)
    offset_m: float = Field(default=0.0, ge=0.0, le=1000.0)
    odometer_scale_std_percent: float = Field(default=0.0, ge=0.0, le=3.0)
    frozen_every_m: float = Field(default=1000.0, ge=10.0, le=1e6)
    frozen_length_m: NotNegative = 0.0

    def plan(self) -> PositionErrors:
        """Return the position errors in SI units."""
        return PositionErrors(
            offset=self.largest_offset_m,
            scale=self.largest_scale_percent / 100.0,
            offset_std=self.offset_std_m,
            scale_std=self.scale_std_percent / 100.0,
            fixed_offset=self.offset_m,
            odometer_scale_std=self.odometer_scale_std_percent / 100.0,
            frozen_every=self.frozen_every_m,
            frozen_length=self.frozen_length_m,
        )


class BusTable(InputTable):
    """``[bus]``."""

    lost_frames_percent: float = Field(default=0.0, ge=0.0, le=50.0)
    bursts_per_hour: float = Field(default=0.0, ge=0.0, le=3600.0)
    burst_s: float = Field(default=0.5, ge=0.0, le=60.0)
    jitter_us: float = Field(default=0.0, ge=0.0, le=1000.0)
    recorder_clock_offset_s: float = Field(default=0.0, ge=-86400.0, le=86400.0)
    stamp_jitter_us: float = Field(default=0.0, ge=0.0, le=1000.0)
    bitrate_kbit_s: float = Field(default=0.0, ge=0.0, le=1000.0)
    node_delay_us: float = Field(default=0.0, ge=0.0, le=500.0)
    position_delay_ms: float = Field(default=0.0, ge=0.0, le=3.9)

    nodes_swapped: bool = False

    @model_validator(mode="after")
    def _check_delays(self) -> Self:
        for key in ("node_delay_us", "position_delay_ms"):
            if self.bitrate_kbit_s == 0.0 and getattr(self, key) > 0.0:
                raise field_error("needs a 'bitrate_kbit_s'", key)
        return self

    def plan(self) -> BusPlan:
        """Return the errors of the bus in SI units."""
        return BusPlan(
            lost_share=self.lost_frames_percent / 100.0,
            burst_per_hour=self.bursts_per_hour,
            burst=self.burst_s,
            jitter=1e-6 * self.jitter_us,
            recorder_offset=self.recorder_clock_offset_s,
            stamp_jitter=1e-6 * self.stamp_jitter_us,
            bit_rate=1e3 * self.bitrate_kbit_s,
            node_delay=1e-6 * self.node_delay_us,
            position_delay=1e-3 * self.position_delay_ms,
            nodes_swapped=self.nodes_swapped,
        )
