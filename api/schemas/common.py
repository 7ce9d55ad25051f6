"""What every representation is made of: numbers with their uncertainty, links, pages."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Annotated, Any, Generic, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from estimation.values.arrays import FloatArray
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode, code_of, text_of

NOT_FINITE = Reason(ReasonCode.NOT_FINITE, "the calculation gave no finite number")
ItemT = TypeVar("ItemT")
Href = Annotated[str, Field(examples=["/v1/wheelsets/WS-0001"])]
Links = Annotated[dict[str, Href], Field(description="Paths of related resources, by relation.")]


class Representation(BaseModel):
    """A value that goes out; fields are never added at run time."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True)


class Body(BaseModel):
    """A body that comes in; unknown fields are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)


class Page(Representation, Generic[ItemT]):
    """One page of a list; ``next_cursor`` and ``next`` are null on the last."""

    items: list[ItemT]
    next_cursor: str | None = Field(description="Hand it back as `cursor`, with the same filter.")
    next: str | None = Field(description="The path of the next page; the same as Link rel=next.")


class Uncertain(Representation):
    """A number with its uncertainty; null means unknown, and `reason` and `reason_code` explain why."""

    value: float | None = Field(description="The value; null means unknown.")
    std: float | None = Field(description="Standard deviation; null where the value is unknown.")
    interval_95: tuple[float, float] | None = Field(description="95 % interval; null where the value is unknown.")
    n_windows: float = Field(description="Effective number of windows behind the value.")
    status: Status
    reason: str | None
    reason_code: ReasonCode | None

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "value": 0.182,
                    "std": 0.006,
                    "interval_95": [0.17, 0.194],
                    "n_windows": 12.0,
                    "status": "estimated",
                    "reason": None,
                    "reason_code": None,
                }
            ]
        }
    )


def finite(value: float | None, scale: float = 1.0) -> float | None:
    """Return ``value * scale``; None where that is no finite number, for JSON has no others."""
    if value is None:
        return None
    scaled = float(value) * scale
    return scaled if math.isfinite(scaled) else None


def finite_list(values: Sequence[float] | FloatArray, scale: float = 1.0) -> list[float | None]:
    """Return every value as :func:`finite` does."""
    with np.errstate(over="ignore"):  # beyond all floats is no finite number
        scaled = np.asarray(values, np.float64) * scale
    found: list[float | None] = scaled.tolist()
    for place in np.flatnonzero(~np.isfinite(scaled)):
        found[place] = None
    return found


def why(reason: Reason | None) -> dict[str, Any]:
    """Return a reason as two fields, its sentence and its code; both null without one."""
    return {"reason": text_of(reason), "reason_code": code_of(reason)}


def uncertain(estimate: Estimate, scale: float = 1.0) -> Uncertain:
    """Return an estimate in the unit that ``scale`` turns it into; unknown where a part of it is no finite number."""
    value, std = finite(estimate.value, scale), finite(estimate.std, scale)
    low, high = finite(estimate.low, scale), finite(estimate.high, scale)
    status, reason, interval = estimate.status, estimate.reason, None
    if value is None or std is None or low is None or high is None:
        value, std, reason = None, None, reason or NOT_FINITE
        status = Status.INVALID if status is Status.ESTIMATED else status
    else:
        interval = (min(low, high), max(low, high))
    count = finite(estimate.count) or 0.0
    return Uncertain(value=value, std=std, interval_95=interval, n_windows=count, status=status, **why(reason))


_FOLDERS = re.compile(r"(?<![\w:/.])/(?:[^\s/:'\"]+/)+")


def without_folders(message: str) -> str:
    """Return a message without the folders of the machine."""
    return _FOLDERS.sub("", message)
