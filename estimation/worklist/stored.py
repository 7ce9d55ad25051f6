"""What is stored of the worklist beside what its rows say: what a row is made from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from estimation.values.alerts import MileageNow, OpenAlert
from estimation.values.geometry import GEOMETRY, GeometryRecord
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.runs import Facet
from estimation.values.trend import TREND, TrendRecord
from estimation.vehicle.vehicle_class import VehicleClass

FORM = 3  # grows with every change of what a row says, so that all rows are made again
STAGE = "worklist"
FACETS = (Facet.REGISTRY, Facet.WINDOWS, Facet.ALERTS, GEOMETRY.stage, TREND.stage)
"""What a row is made from: whoever raises one of these makes it again in the same transaction."""


@dataclass(frozen=True, slots=True)
class WorklistInputs:
    """All that is stored of a wheelset and decides how urgent it is."""

    wheelset: WheelsetRecord
    vehicle: VehicleRecord | None  # None where it is not mounted
    vehicle_class: VehicleClass | None  # None where it is not on file
    geometry: GeometryRecord | None  # current
    trend: TrendRecord | None  # latest
    last_window_ns: int | None  # end of its newest window that was estimated or waits for it
    mileage: MileageNow | None  # last reading that is believed
    alerts: Sequence[OpenAlert] = ()  # open ones, in any order
    failure: Reason | None = None  # why its geometry or trend cannot be read or understood; None where they can
    refused: Mapping[ReasonCode, int] = field(default_factory=dict)  # newest windows, the most frequent first
