"""A bin table packed: only the cells (group, bin) that hold anything."""

from __future__ import annotations

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.geometry import BinTable
from fleet_db.packing import pack, unpack

KIND = "bin_table"
VERSION = 1


def pack_bin_table(table: BinTable) -> bytes:
    """Return ``table`` as one blob. A cell is empty when every bit of its weight and moments is zero."""
    cells = np.concatenate([table.weight[:, :, None], table.lateral, table.yaw], axis=2)
    filled: BoolArray = np.any(cells.view(np.int64), axis=2)
    return pack(
        KIND,
        VERSION,
        {
            "parameter_key": table.parameter_key,
            "samples": int(table.samples),
            "windows": int(table.windows),
            "groups": len(table.weight),
            "lateral": table.lateral.shape[2],
        },
        {"edges": table.edges, "filled": np.packbits(filled), "cells": np.ascontiguousarray(cells[filled].T)},
    )


def unpack_bin_table(blob: bytes, *, where: str) -> BinTable:
    """Return the table, bit for bit.

    Raises
    ------
    StorageError
        The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, KIND, where=where)
    edges, found = packed.arrays["edges"], packed.arrays["cells"]
    groups, bins = packed.scalars["groups"], len(edges) - 1
    filled = np.unpackbits(packed.arrays["filled"], count=groups * bins).astype(bool)
    yaw_from = 1 + packed.scalars["lateral"]
    weight, lateral, yaw = (
        _spread(rows, filled, groups, bins) for rows in (found[:1], found[1:yaw_from], found[yaw_from:])
    )
    return BinTable(
        parameter_key=packed.scalars["parameter_key"],
        edges=edges,
        weight=weight[:, :, 0],
        lateral=lateral,
        yaw=yaw,
        samples=packed.scalars["samples"],
        windows=packed.scalars["windows"],
    )


def _spread(rows: FloatArray, filled: BoolArray, groups: int, bins: int) -> FloatArray:
    """Return columns ``rows`` (m, filled) put back among the empty cells: (groups, bins, m)."""
    cells = np.zeros((groups * bins, len(rows)))
    cells[filled] = rows.T
    cells.flags.writeable = False
    return cells.reshape(groups, bins, len(rows))
