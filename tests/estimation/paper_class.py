"""The paper's vehicle as a class, and what windows of it are estimated with."""

from __future__ import annotations

from dataclasses import replace

from estimation.motion.integration import WindowParameters
from estimation.tables.bin_table import bin_parameters
from estimation.vehicle.vehicle_class import Arrangement, SensorLayout, VehicleClass, VehicleParameters

PAPER_CLASS = VehicleClass(
    code="paper",
    name="Single wheelset",
    source="Table A.1",
    arrangement=Arrangement.SINGLE_WHEELSET,
    parameters=VehicleParameters(),
    sensors=SensorLayout(measures_gravity=False),
)
WINDOWS = WindowParameters(PAPER_CLASS)
BINS = bin_parameters(WINDOWS)


def paper_class(code: str) -> VehicleClass:
    """Return the same under another code."""
    return replace(PAPER_CLASS, code=code)
