"""A row of the worklist as JSON, and back."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import orjson

from estimation.values.alerts import (
    AxlePosition,
    BogiePlace,
    Condition,
    MileageNow,
    OpenAlert,
    Severity,
    Urgency,
    WorklistRow,
    WorklistState,
)
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, Reprofiling, WheelsetRecord


def to_document(row: WorklistRow) -> str:
    """Return a row as JSON."""
    return orjson.dumps(asdict(row), option=orjson.OPT_SORT_KEYS).decode()


def from_document(document: str) -> WorklistRow:
    """Return the row of a JSON text that :func:`to_document` made."""
    fields = orjson.loads(document)
    position = fields["position"]
    return WorklistRow(
        wheelset=_wheelset(fields["wheelset"]),
        vehicle_class=fields["vehicle_class"],
        position=None if position is None else _position(position),
        state=_state(fields["state"]),
    )


def _wheelset(fields: dict[str, Any]) -> WheelsetRecord:
    mounting = fields["mounting"]
    turned = tuple(Reprofiling(**one) for one in fields["reprofilings"])
    mounted = None if mounting is None else Mounting(**mounting)
    return WheelsetRecord(**(fields | {"mounting": mounted, "reprofilings": turned}))


def _position(fields: dict[str, Any]) -> AxlePosition:
    place = fields["place"]
    return AxlePosition(fields["bogie"], None if place is None else BogiePlace(place))


def _state(fields: dict[str, Any]) -> WorklistState:
    mileage = fields["mileage"]
    converted = {
        "status": Status(fields["status"]),
        "conicity": _estimate(fields["conicity"]),
        "slope_per_1000_km": _estimate(fields["slope_per_1000_km"]),
        "distance_to_limit_km": Forecast(**fields["distance_to_limit_km"]),
        "date_of_limit_ns": Forecast(**fields["date_of_limit_ns"]),
        "forecast_reason": _reason(fields["forecast_reason"]),
        "mileage": None if mileage is None else MileageNow(**mileage),
        "alerts": tuple(_alert(one) for one in fields["alerts"]),
        "urgency": Urgency(fields["urgency"]),
        "reasons": tuple(Reason(ReasonCode(one["code"]), one["text"]) for one in fields["reasons"]),
    }
    return WorklistState(**(fields | converted))


def _estimate(fields: dict[str, Any]) -> Estimate:
    return Estimate(**(fields | {"status": Status(fields["status"]), "reason": _reason(fields["reason"])}))


def _reason(fields: dict[str, Any] | None) -> Reason | None:
    return None if fields is None else Reason(ReasonCode(fields["code"]), fields["text"])


def _alert(fields: dict[str, Any]) -> OpenAlert:
    converted = {"severity": Severity(fields["severity"]), "condition": Condition(fields["condition"])}
    return OpenAlert(**(fields | converted))
