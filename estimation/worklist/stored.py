"""What is stored of the worklist beside what its rows say: what a row is made from, and how rows are ordered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from estimation.values.alerts import MileageNow, OpenAlert, Urgency, WorklistState
from estimation.values.geometry import GEOMETRY, GeometryRecord
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import VehicleRecord, WheelsetRecord
from estimation.values.runs import Facet
from estimation.values.trend import TREND, TrendRecord
from estimation.vehicle.vehicle_class import VehicleClass

FORM = 1  # grows with every change of what a row says, so that all rows are made again
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


FAR_KM = 1e9  # stands for a distance that is not known, behind all that are
BAND_KM = 1e10  # from one class of urgency to the next


def urgency_key(state: WorklistState) -> float:
    """Return the number that orders wheelsets by urgency, the most urgent first."""
    # within a class the one comes first whose limit may be reached first (p10); over the limit, the most certain one
    within = FAR_KM if state.distance_to_limit_km.p10 is None else state.distance_to_limit_km.p10
    if state.urgency is Urgency.OVER_LIMIT:
        within = 1.0 - (state.probability_over_limit or 0.0)
    return state.urgency.rank * BAND_KM + min(within, FAR_KM)


def distance_key(state: WorklistState) -> float | None:
    """Return the number that orders wheelsets by their distance to the limit: its median; None where it is not known.

    A median beyond the horizon comes behind all others, those first whose limit may be reached within it (p10).
    """
    distance = state.distance_to_limit_km
    if distance.p50 is not None:
        return distance.p50
    if distance.p10 is not None:
        return FAR_KM + distance.p10
    beyond = state.forecast_reason is not None and state.forecast_reason.code is ReasonCode.BEYOND_HORIZON
    return 2.0 * FAR_KM if beyond else None
