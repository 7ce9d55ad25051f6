"""What is true of a simulated fleet, as ``truth.json`` beside the recordings holds it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimation.errors import NotFoundError
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.geometry import WheelsetGeometry

AMPLITUDES = tuple(float(a) for a in np.arange(4, 13) * 0.25e-3)  # m: 1.0 to 3.0 mm
_CURVES = ("displacement", "difference", "radius_sum", "angle_sum", "angle_difference")


@dataclass(frozen=True, slots=True)
class TrueWheelset:
    """The true geometry of a wheelset at nominal gauge, and where it runs."""

    serial: str
    vehicle: str
    axle: int  # from 1
    displacement: FloatArray  # (n,) m, y - d
    difference: FloatArray  # (n,) m, rL - rR
    radius_sum: FloatArray  # (n,) m
    angle_sum: FloatArray  # (n,) rad
    angle_difference: FloatArray  # (n,) rad
    amplitude: FloatArray  # (k,) m: ``AMPLITUDES``
    conicity: FloatArray  # (k,); NaN where it has none
    nonlinearity: float  # 1/mm
    zero_crossing: float  # m

    def __post_init__(self) -> None:
        n, k = len(self.displacement), len(self.amplitude)
        for name in _CURVES:
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        for name in ("amplitude", "conicity"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (k,), name=name))


def read_truth(path: Path, campaign: int = 1) -> tuple[TrueWheelset, ...]:
    """Return what is true of every wheelset, in the order of their serials.

    Args:
        path: The ``truth.json`` of a simulation.
        campaign: From 1.

    Raises:
        NotFoundError: There is no such campaign.
    """
    wheelsets = json.loads(path.read_text(encoding="utf-8"))["wheelsets"]
    found = [_wheelset(item, _campaign(item, campaign)) for item in wheelsets]
    return tuple(sorted(found, key=lambda item: item.serial))


def conicity_errors(found: WheelsetGeometry, truth: TrueWheelset) -> list[tuple[float, bool] | None]:
    """Return error and whether the 95 % interval holds the truth at each amplitude of the truth; None: no estimate.

    Args:
        truth: Of the same wheelset.
    """
    compared: list[tuple[float, bool] | None] = []
    for amplitude, true in zip(truth.amplitude, truth.conicity, strict=True):
        at = int(np.argmin(np.abs(found.amplitude - amplitude)))
        estimate = found.conicity[at]
        same = bool(np.isclose(found.amplitude[at], amplitude, rtol=0.0, atol=1e-9))
        if not same or estimate.value is None or estimate.low is None or estimate.high is None:
            compared.append(None)
        else:
            compared.append((float(estimate.value - true), bool(estimate.low <= true <= estimate.high)))
    return compared


def _campaign(wheelset: dict[str, Any], campaign: int) -> dict[str, Any]:
    for item in wheelset["campaigns"]:
        if item["campaign"] == campaign:
            return dict(item)
    raise NotFoundError("campaign", str(campaign))


def _wheelset(wheelset: dict[str, Any], facts: dict[str, Any]) -> TrueWheelset:
    conicity = np.array([np.nan if value is None else value for value in facts["equivalent_conicity"]])
    known = 1e-3 * np.array(facts["amplitude_mm"])
    chosen = [int(np.argmin(np.abs(known - amplitude))) for amplitude in AMPLITUDES]
    return TrueWheelset(
        serial=wheelset["serial"],
        vehicle=wheelset["vehicle"],
        axle=wheelset["axle"],
        displacement=1e-3 * np.array(facts["lateral_displacement_mm"]),
        difference=1e-3 * np.array(facts["rolling_radius_difference_mm"]),
        radius_sum=1e-3 * np.array(facts["rolling_radius_sum_mm"]),
        angle_sum=np.array(facts["contact_angle_sum_rad"]),
        angle_difference=np.array(facts["contact_angle_difference_rad"]),
        amplitude=np.array(AMPLITUDES),
        conicity=conicity[chosen],
        nonlinearity=_number(facts["nonlinearity_parameter"]),
        zero_crossing=1e-3 * _number(facts["zero_crossing_mm"]),
    )


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
