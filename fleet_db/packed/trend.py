"""A wear trend packed, with its points."""

from __future__ import annotations

from estimation.values.quantities import Status
from estimation.values.trend import WearTrend
from fleet_db.packed.numbers import (
    estimate_from_json,
    estimate_to_json,
    forecast_from_json,
    forecast_to_json,
    number_from_json,
    number_to_json,
    real_from_json,
)
from fleet_db.packing import pack, unpack

KIND = "wear_trend"
VERSION = 1


def pack_trend(trend: WearTrend) -> bytes:
    """Return ``trend`` as one blob."""
    return pack(
        KIND,
        VERSION,
        {
            "quantity": trend.quantity,
            "slope_per_1000_km": estimate_to_json(trend.slope_per_1000_km),
            "slope_per_year": estimate_to_json(trend.slope_per_year),
            "current": estimate_to_json(trend.current),
            "limit": number_to_json(trend.limit),
            "distance_to_limit_km": forecast_to_json(trend.distance_to_limit_km),
            "date_of_limit_ns": forecast_to_json(trend.date_of_limit_ns),
            "probability_over_limit": number_to_json(trend.probability_over_limit),
            "status": str(trend.status),
            "reason": trend.reason,
        },
        {
            "mileage_km": trend.mileage_km,
            "measured_ns": trend.measured_ns,
            "value": trend.value,
            "std": trend.std,
        },
    )


def unpack_trend(blob: bytes, *, where: str) -> WearTrend:
    """Return the trend, bit for bit.

    Raises
    ------
    StorageError
        The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, KIND, where=where)
    scalars, arrays = packed.scalars, packed.arrays
    return WearTrend(
        quantity=scalars["quantity"],
        mileage_km=arrays["mileage_km"],
        measured_ns=arrays["measured_ns"],
        value=arrays["value"],
        std=arrays["std"],
        slope_per_1000_km=estimate_from_json(scalars["slope_per_1000_km"]),
        slope_per_year=estimate_from_json(scalars["slope_per_year"]),
        current=estimate_from_json(scalars["current"]),
        limit=real_from_json(scalars["limit"]),
        distance_to_limit_km=forecast_from_json(scalars["distance_to_limit_km"]),
        date_of_limit_ns=forecast_from_json(scalars["date_of_limit_ns"]),
        probability_over_limit=number_from_json(scalars["probability_over_limit"]),
        status=Status(scalars["status"]),
        reason=scalars["reason"],
    )
