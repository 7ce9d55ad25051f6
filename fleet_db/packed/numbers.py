"""Single numbers inside a JSON header, exactly: None, whole numbers, and floats with NaN, infinity and signed zero."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimation.errors import StorageError
from estimation.values.json_value import JsonValue
from estimation.values.quantities import Estimate, Forecast, Status


def number_to_json(value: float | np.integer[Any] | None) -> JsonValue:
    """Return None and whole numbers as they are, and a float in hexadecimal, which loses no bit."""
    if value is None:
        return None
    return int(value) if isinstance(value, int | np.integer) else float(value).hex()


def number_from_json(value: JsonValue) -> float | None:
    """Return what ``number_to_json`` was given."""
    if value is None or isinstance(value, int):
        return value
    if isinstance(value, str):
        return float.fromhex(value)
    raise StorageError(f"a packed number is {value!r}")


def real_from_json(value: JsonValue) -> float:
    """Return a number that cannot be missing.

    Raises
    ------
    StorageError
        It is missing.
    """
    number = number_from_json(value)
    if number is None:
        raise StorageError("a packed number is missing")
    return number


def estimate_to_json(estimate: Estimate) -> JsonValue:
    """Return the fields of ``estimate`` in their order."""
    numbers = (estimate.value, estimate.std, estimate.low, estimate.high, estimate.count)
    return [*map(number_to_json, numbers), str(estimate.status), estimate.reason]


def estimate_from_json(fields: list[JsonValue]) -> Estimate:
    """Return what ``estimate_to_json`` was given."""
    *numbers, count, status, reason = fields
    value, std, low, high = map(number_from_json, numbers)
    return Estimate(value, std, low, high, real_from_json(count), Status(str(status)), str(reason))


def forecast_to_json(forecast: Forecast) -> JsonValue:
    """Return the three quantiles."""
    return [number_to_json(value) for value in (forecast.p10, forecast.p50, forecast.p90)]


def forecast_from_json(fields: list[JsonValue]) -> Forecast:
    """Return what ``forecast_to_json`` was given."""
    return Forecast(*map(number_from_json, fields))
