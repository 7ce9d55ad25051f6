"""What a row of the worklist is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from estimation.values.geometry import GeometryRecord
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.trend import TrendRecord
from estimation.values.worklist import MileageNow, OpenAlert
from estimation.vehicle.vehicle_class import VehicleClass


@dataclass(frozen=True, slots=True)
class WorklistInputs:
    """All that is stored of a wheelset and decides how urgent it is.

    Attributes:
        wheelset, vehicle, vehicle_class: Its records; no vehicle where it is not mounted, no class where that is not on
            file.
        geometry, trend: The current geometry and the latest trend.
        last_window_ns: End of its newest window that was estimated or waits for it.
        mileage: Last reading that is believed.
        alerts: Open ones, in any order.
        failure: Why its geometry or trend cannot be read or understood; None where they can.
        refused: How many of its newest windows are refused, by reason, the most frequent first; where it has no
            geometry.
    """

    wheelset: WheelsetRecord
    vehicle: VehicleRecord | None
    vehicle_class: VehicleClass | None
    geometry: GeometryRecord | None
    trend: TrendRecord | None
    last_window_ns: int | None
    mileage: MileageNow | None
    alerts: Sequence[OpenAlert] = ()
    failure: Reason | None = None
    refused: Mapping[ReasonCode, int] = field(default_factory=dict)
