"""Windows, alignments and geometries that are made, not loaded or estimated."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinStatus, BinValues, WheelsetGeometry
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment
from estimation.values.windows import ACCELERATIONS, Window, WindowQuality

GOOD = WindowQuality(1.0, 0.0, 0, 0.0, 0.0, 5.0, 25.0, 1.0, sensor_fault=False)
UNKNOWN = Estimate.unknown(Reason(ReasonCode.NOT_FINITE, "not made"))


def made_window(
    values: FloatArray,
    wheelset: str,
    start_ns: int,
    interval_s: float,
    **others: Any,  # noqa: ANN401 - any field
) -> Window:
    """Return a window of samples (n, 4) in the order of ``ACCELERATIONS``; ``speed`` and ``distance`` must be given."""
    fields: dict[str, Any] = {
        "vehicle": "V",
        "axle": 1,
        "length_ns": round(len(values) * interval_s * 1e9),
        "valid": np.ones(len(values), dtype=np.bool_),
        "resolution": (1e-4, 1e-4, 1e-4, 1e-4),
        "track_section": "S",
        "odometer_m": 0.0,
        "quality": GOOD,
        **dict(zip(ACCELERATIONS, values.T, strict=True)),
    }
    return Window(wheelset=wheelset, start_ns=start_ns, sample_interval_s=interval_s, **(fields | others))


def made_alignment(s: FloatArray, alignment: FloatArray, std: float | FloatArray, section: str = "S") -> TrackAlignment:
    """Return what is on file of a section at places (n,), m: its alignment with this std, m, and its nominal gauge."""
    zero = np.zeros(len(s))
    return TrackAlignment(section, 1, s, alignment, zero + std, zero, zero, zero.astype(np.int64), Status.ESTIMATED)


def made_geometry(
    edges: FloatArray,
    difference: BinValues | None,
    amplitude: FloatArray,
    **others: Any,  # noqa: ANN401 - any field
) -> WheelsetGeometry:
    """Return a geometry of which R is known in bins (b), or nothing, and what else is given."""
    bins = len(edges) - 1
    nothing = BinValues(np.full(bins, np.nan), np.full(bins, np.nan), (BinStatus.UNOBSERVABLE,) * bins)
    fields: dict[str, Any] = {
        "samples": np.ones(bins),
        "rolling_radius_sum": nothing,
        "rolling_radius_difference": nothing if difference is None else difference,
        "contact_angle_sum": nothing,
        "contact_angle_difference": nothing,
        "conicity": (UNKNOWN,) * len(amplitude),
        "reported_amplitude": float(amplitude[-1]),
        "equivalent_conicity": UNKNOWN,
        "nonlinearity": UNKNOWN,
        "zero_crossing": UNKNOWN,
        "windows": 8,
        "parameter_key": "bench",
        "status": Status.ESTIMATED,
    }
    return WheelsetGeometry(bin_edges=edges, amplitude=amplitude, **(fields | others))
