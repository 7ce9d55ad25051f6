"""What is stored whole in one blob: trends, geometries, alignments, layouts, bin tables, profiles of wheels.

A value is packed by its own fields (``fleet_db.fields``); here is only what is stored otherwise than declared. The
same value is the same blob: versions of a track are compared by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, TypeVar, cast

import numpy as np

from estimation.contact.profiles import Profile
from estimation.values.arrays import BoolArray
from estimation.values.fields import JsonValue
from estimation.values.geometry import COMBINATIONS, BinStatus, BinTable, BinValues, FilledCells, WheelsetGeometry
from estimation.values.roll_up import RollingSums
from estimation.values.track import GaugeShift, TrackAlignment, TrackFindings, TrackLayout
from fleet_db.fields import Array, fields_of, pack, to_json, unpack, value_of

V = TypeVar("V")
VERSION = 1
ALIGNMENTS = 4  # that are kept unpacked, some megabytes each
GEOMETRY, LAYOUT, BIN_TABLE = "wheelset_geometry", "track_layout", "bin_table"
WHEEL_PAIR, ALIGNMENT = "wheel_pair", "track_alignment"
ROLLING_SUMS = "rolling_sums"
STATUSES = {status.value: status for status in BinStatus}
PROFILE_ARRAYS = ("y", "z", "slope")


def pack_value(value: object) -> bytes:
    """Return a value as one blob, by its own fields."""
    if isinstance(value, WheelsetGeometry):
        return pack_geometry(value)
    return pack(type(value).__name__, VERSION, *fields_of(value))


def unpack_value(kind: type[V], blob: bytes, *, where: str) -> V:
    """Return the value of a class, bit for bit.

    Raises:
        StorageError: The blob is damaged; ``where`` names it.
    """
    if issubclass(kind, WheelsetGeometry):
        return cast("V", unpack_geometry(blob, where=where))
    packed = unpack(blob, kind.__name__, where=where)
    return value_of(kind, packed.scalars, packed.arrays)


def pack_geometry(geometry: WheelsetGeometry) -> bytes:
    """Return ``geometry`` as one blob; the four combinations are stacked."""
    combinations: dict[str, BinValues] = {name: getattr(geometry, name) for name in COMBINATIONS}
    statuses = {name: to_json(values.status) for name, values in combinations.items()}
    scalars, arrays = fields_of(geometry, without=COMBINATIONS)
    return pack(
        GEOMETRY,
        VERSION,
        {"combinations": statuses, **scalars},
        {
            **arrays,
            "values": np.stack([values.value for values in combinations.values()]),
            "stds": np.stack([values.std for values in combinations.values()]),
        },
    )


def unpack_geometry(blob: bytes, *, where: str) -> WheelsetGeometry:
    """Return the geometry, bit for bit.

    Raises:
        StorageError: The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, GEOMETRY, where=where)
    statuses, arrays = packed.scalars["combinations"], packed.arrays
    combinations = {
        name: BinValues(value, std, tuple(map(STATUSES.__getitem__, listed)))
        for (name, listed), value, std in zip(statuses.items(), arrays["values"], arrays["stds"], strict=True)
    }
    return value_of(WheelsetGeometry, packed.scalars, arrays, **combinations)


def pack_layout(layout: TrackLayout) -> bytes:
    """Return ``layout`` as one blob, without its version, so that the same content is the same blob."""
    return pack(LAYOUT, VERSION, *fields_of(layout, without={"version"}))


def unpack_layout(blob: bytes, version: int, *, where: str) -> TrackLayout:
    """Return the layout as ``version``, bit for bit.

    Args:
        blob: From ``pack_layout``.
        where: Name of the place it was read from, for messages.

    Raises:
        DamagedError: The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, LAYOUT, where=where)
    return value_of(TrackLayout, packed.scalars, packed.arrays, version=version)


def pack_alignment(alignment: TrackAlignment) -> bytes:
    """Return ``alignment`` as one blob, without its version, so that the same content is the same blob."""
    scalars, arrays = fields_of(alignment, without={"version", "findings"})
    if alignment.findings is not None:
        scalars["findings"], shifts = _pack_findings(alignment.findings)
        arrays |= shifts
    return pack(ALIGNMENT, VERSION, scalars, arrays)


@lru_cache(maxsize=ALIGNMENTS)
def unpack_alignment(blob: bytes, version: int, *, where: str) -> TrackAlignment:
    """Return the alignment as ``version``, bit for bit; the same again is the same object, and so is what it gives.

    Args:
        blob: From ``pack_alignment``.
        where: Name of the place it was read from, for messages.

    Raises:
        StorageError: The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, ALIGNMENT, where=where)
    stored = packed.scalars.get("findings")
    findings = None if stored is None else _unpack_findings(stored, packed.arrays)
    return value_of(TrackAlignment, packed.scalars, packed.arrays, version=version, findings=findings)


def _pack_findings(findings: TrackFindings) -> tuple[JsonValue, dict[str, Array]]:
    """Return findings as JSON and stacked arrays: the grids of each wheelset's gauge shift, and (wheelset, r, e)."""
    names = sorted(findings.gauge_shifts)
    stored: JsonValue = {
        "stiffness_ratio": to_json(dict(sorted(findings.stiffness_ratio.items()))),
        "stiffness_ratio_std": to_json(findings.stiffness_ratio_std),
        "gauge_shifts": to_json(names),
    }
    if not names:
        return stored, {}
    shifts = [findings.gauge_shifts[name] for name in names]
    return stored, {
        "shift_difference": np.stack([item.difference for item in shifts]),
        "shift_gauge": np.stack([item.gauge for item in shifts]),
        "shift": np.stack([item.shift for item in shifts]),
    }


def _unpack_findings(stored: Mapping[str, Any], arrays: Mapping[str, Array]) -> TrackFindings:
    shifts = {
        name: GaugeShift(arrays["shift_difference"][k], arrays["shift_gauge"][k], arrays["shift"][k])
        for k, name in enumerate(stored["gauge_shifts"])
    }
    return value_of(TrackFindings, stored, {}, gauge_shifts=shifts)


def pack_wheel_pair(left: Profile, right: Profile) -> bytes:
    """Return the profiles of both wheels of a wheelset as one blob."""
    sides = {"left": left, "right": right}
    return pack(
        WHEEL_PAIR,
        VERSION,
        {side: profile.name for side, profile in sides.items()},
        {f"{side}_{name}": getattr(profile, name) for side, profile in sides.items() for name in PROFILE_ARRAYS},
    )


def unpack_wheel_pair(blob: bytes, *, where: str) -> tuple[Profile, Profile]:
    """Return the left and the right profile, bit for bit.

    Raises:
        DamagedError: The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, WHEEL_PAIR, where=where)
    left, right = (
        Profile("wheel", packed.scalars[side], *(packed.arrays[f"{side}_{name}"] for name in PROFILE_ARRAYS))
        for side in ("left", "right")
    )
    return left, right


def pack_bin_table(table: BinTable | FilledCells) -> bytes:
    """Return ``table`` as one blob. A cell is empty when every bit of its weight and moments is zero."""
    if isinstance(table, BinTable):
        cells = np.concatenate([table.weight[:, :, None], table.lateral, table.yaw], axis=2)
        filled: BoolArray = np.any(cells.view(np.int64), axis=2)
        groups, columns = len(table.weight), cells[filled].T
    else:
        filled = np.zeros(table.groups * (len(table.edges) - 1), dtype=np.bool_)
        filled[table.cells] = True
        groups, columns = table.groups, np.concatenate([table.weight[None], table.lateral.T, table.yaw.T])
    return pack(
        BIN_TABLE,
        VERSION,
        {
            "parameter_key": table.parameter_key,
            "samples": int(table.samples),
            "windows": int(table.windows),
            "groups": groups,
            "lateral": table.lateral.shape[-1],
        },
        {"edges": table.edges, "filled": np.packbits(filled), "cells": np.ascontiguousarray(columns)},
    )


def unpack_bin_table(blob: bytes, *, where: str) -> BinTable:
    """Return the table, bit for bit.

    Raises:
        StorageError: The blob is damaged; ``where`` names it.
    """
    return unpack_filled_cells(blob, where=where).table()


def unpack_filled_cells(blob: bytes, *, where: str) -> FilledCells:
    """Return the filled cells of a packed bin table, bit for bit.

    Args:
        blob: From ``pack_bin_table``.
        where: Name of the place it was read from, for messages.

    Raises:
        StorageError: The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, BIN_TABLE, where=where)
    edges, rows = packed.arrays["edges"], packed.arrays["cells"].T
    groups = packed.scalars["groups"]
    filled = np.unpackbits(packed.arrays["filled"], count=groups * (len(edges) - 1))
    yaw_from = 1 + packed.scalars["lateral"]
    return FilledCells(
        parameter_key=packed.scalars["parameter_key"],
        edges=edges,
        groups=groups,
        cells=np.flatnonzero(filled),
        weight=rows[:, 0],
        lateral=rows[:, 1:yaw_from],
        yaw=rows[:, yaw_from:],
        samples=packed.scalars["samples"],
        windows=packed.scalars["windows"],
    )


def pack_rolling_sums(parts: Sequence[RollingSums]) -> bytes:
    """Return what a window says of its rolling radius as one blob."""
    products = np.array([one.products for one in parts], dtype=np.float64)
    noise = np.array([one.noise for one in parts], dtype=np.float64)
    return pack(ROLLING_SUMS, VERSION, {}, {"products": products, "noise": noise})


def unpack_rolling_sums(blob: bytes, *, where: str) -> tuple[RollingSums, ...]:
    """Return the sums of each part of a window, bit for bit.

    Args:
        blob: From ``pack_rolling_sums``.
        where: Name of the place it was read from, for messages.

    Raises:
        StorageError: The blob is damaged; ``where`` names it.
    """
    arrays = unpack(blob, ROLLING_SUMS, where=where).arrays
    return tuple(RollingSums(*both) for both in zip(arrays["products"], arrays["noise"], strict=True))
