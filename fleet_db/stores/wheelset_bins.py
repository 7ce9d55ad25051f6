"""The current values of each wheelset's bins as plain rows, for queries in SQL."""

from __future__ import annotations

from typing import Any

from sqlalchemy import Connection, delete, insert

from estimation.values.geometry import COMBINATIONS, BinValues, WheelsetGeometry
from fleet_db.models import WheelsetBinRow
from fleet_db.rows import null_if_nan, table_of

BINS = table_of(WheelsetBinRow)
UNITS = {name: "rad" if name.startswith("contact_angle") else "m" for name in COMBINATIONS}


def replace_bins(connection: Connection, wheelset: str, geometry_id: int, geometry: WheelsetGeometry) -> None:
    """Replace the rows of ``wheelset`` by the bins of ``geometry``."""
    connection.execute(delete(BINS).where(BINS.c.wheelset == wheelset))
    rows = [
        {
            "wheelset": wheelset,
            "bin": index,
            "geometry_id": geometry_id,
            "lateral_displacement_low_m": float(geometry.bin_edges[index]),
            "lateral_displacement_high_m": float(geometry.bin_edges[index + 1]),
            "samples": null_if_nan(float(geometry.samples[index])),
            **_columns(geometry, index),
        }
        for index in range(len(geometry.samples))
    ]
    if rows:
        connection.execute(insert(BINS), rows)


def _columns(geometry: WheelsetGeometry, index: int) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    for name, unit in UNITS.items():
        values: BinValues = getattr(geometry, name)
        columns[f"{name}_{unit}"] = null_if_nan(float(values.value[index]))
        columns[f"{name}_std_{unit}"] = null_if_nan(float(values.std[index]))
        columns[f"{name}_status"] = str(values.status[index])
    return columns
