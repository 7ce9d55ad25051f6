"""What is stored whole in one blob: trends, geometries, alignments, bin tables, profiles, creep, dampers, signatures.

A value is packed by its own fields (``fleet_db.fields``); here is only what is stored otherwise than declared. The
same value is the same blob: versions of a track are compared by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, TypeVar, cast

import numpy as np
import orjson

from estimation.contact.profiles import Profile
from estimation.values.alerts import WorklistRow
from estimation.values.arrays import BoolArray
from estimation.values.fields import JsonValue
from estimation.values.geometry import COMBINATIONS, BinStatus, BinTable, BinValues, FilledCells, WheelsetGeometry
from estimation.values.opinions import DamperSums, FrictionSums, SectionAdhesion, WindowAdhesion, WindowDamper
from estimation.values.roll_up import RollingSums
from estimation.values.signatures import AxlePosition, Place, Signature
from estimation.values.track import GaugeShift, TrackAlignment, TrackFindings, TrackLayout
from fleet_db.fields import Array, fields_of, from_json, pack, to_json, unpack, value_of

V = TypeVar("V")
ALIGNMENTS = 4  # that are kept unpacked, some megabytes each
GEOMETRY, LAYOUT, BIN_TABLE = "wheelset_geometry", "track_layout", "bin_table"
WHEEL_PAIR, ALIGNMENT = "wheel_pair", "track_alignment"
ROLLING_SUMS, SIGNATURES = "rolling_sums", "wear_signatures"
WINDOW_ADHESION, WINDOW_DAMPER = "window_adhesion", "window_damper"
NAMES: Mapping[type[Any], str] = {SectionAdhesion: "section_adhesion"}  # of values that have another than their class
STATUSES = {status.value: status for status in BinStatus}
PROFILE_ARRAYS = ("y", "z", "slope")


def pack_value(value: object) -> bytes:
    """Return a value as one blob, by its own fields."""
    if isinstance(value, WheelsetGeometry):
        return pack_geometry(value)
    return pack(NAMES.get(type(value), type(value).__name__), *fields_of(value))


def unpack_value(kind: type[V], blob: bytes, *, where: str) -> V:
    """Return the value of a class, bit for bit; DamagedError names ``where`` it was read from, here and below."""
    if issubclass(kind, WheelsetGeometry):
        return cast("V", unpack_geometry(blob, where=where))
    return value_of(kind, *unpack(blob, NAMES.get(kind, kind.__name__), where=where))


def pack_geometry(geometry: WheelsetGeometry) -> bytes:
    """Return ``geometry`` as one blob; the four combinations are stacked."""
    combinations: dict[str, BinValues] = {name: getattr(geometry, name) for name in COMBINATIONS}
    statuses = {name: to_json(values.status) for name, values in combinations.items()}
    scalars, arrays = fields_of(geometry, without=COMBINATIONS)
    return pack(
        GEOMETRY,
        {"combinations": statuses, **scalars},
        {
            **arrays,
            "values": np.stack([values.value for values in combinations.values()]),
            "stds": np.stack([values.std for values in combinations.values()]),
        },
    )


def unpack_geometry(blob: bytes, *, where: str) -> WheelsetGeometry:
    """Return the geometry, bit for bit."""
    scalars, arrays = unpack(blob, GEOMETRY, where=where)
    stacked = zip(scalars["combinations"].items(), arrays["values"], arrays["stds"], strict=True)
    combinations = {
        name: BinValues(value, std, tuple(map(STATUSES.__getitem__, listed))) for (name, listed), value, std in stacked
    }
    return value_of(WheelsetGeometry, scalars, arrays, **combinations)


def pack_layout(layout: TrackLayout) -> bytes:
    """Return ``layout`` as one blob, without its version, so that the same content is the same blob."""
    return pack(LAYOUT, *fields_of(layout, without={"version"}))


def unpack_layout(blob: bytes, version: int, *, where: str) -> TrackLayout:
    """Return the layout as ``version``, bit for bit."""
    return value_of(TrackLayout, *unpack(blob, LAYOUT, where=where), version=version)


def pack_alignment(alignment: TrackAlignment) -> bytes:
    """Return ``alignment`` as one blob, without its version, so that the same content is the same blob."""
    scalars, arrays = fields_of(alignment, without={"version", "findings"})
    if alignment.findings is not None:
        scalars["findings"], shifts = _pack_findings(alignment.findings)
        arrays |= shifts
    return pack(ALIGNMENT, scalars, arrays)


@lru_cache(maxsize=ALIGNMENTS)
def unpack_alignment(blob: bytes, version: int, *, where: str) -> TrackAlignment:
    """Return the alignment as ``version``, bit for bit; the same again is the same object, and so is what it gives."""
    scalars, arrays = unpack(blob, ALIGNMENT, where=where)
    stored, findings = scalars.get("findings"), None
    if stored is not None:
        stacked = [arrays.get(name, ()) for name in ("shift_difference", "shift_gauge", "shift")]
        shifts = {name: GaugeShift(*parts) for name, *parts in zip(stored["gauge_shifts"], *stacked, strict=True)}
        findings = value_of(TrackFindings, stored, {}, gauge_shifts=shifts)
    return value_of(TrackAlignment, scalars, arrays, version=version, findings=findings)


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


def pack_wheel_pair(left: Profile, right: Profile) -> bytes:
    """Return the profiles of both wheels of a wheelset as one blob."""
    sides = {"left": left, "right": right}
    return pack(
        WHEEL_PAIR,
        {side: profile.name for side, profile in sides.items()},
        {f"{side}_{name}": getattr(profile, name) for side, profile in sides.items() for name in PROFILE_ARRAYS},
    )


def unpack_wheel_pair(blob: bytes, *, where: str) -> tuple[Profile, Profile]:
    """Return the left and the right profile, bit for bit."""
    scalars, arrays = unpack(blob, WHEEL_PAIR, where=where)
    left, right = (
        Profile("wheel", scalars[side], *(arrays[f"{side}_{name}"] for name in PROFILE_ARRAYS))
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
    """Return the table, bit for bit."""
    return unpack_filled_cells(blob, where=where).table()


def unpack_filled_cells(blob: bytes, *, where: str) -> FilledCells:
    """Return the filled cells of a packed bin table, bit for bit."""
    scalars, arrays = unpack(blob, BIN_TABLE, where=where)
    edges, rows, groups = arrays["edges"], arrays["cells"].T, scalars["groups"]
    filled = np.unpackbits(arrays["filled"], count=groups * (len(edges) - 1))
    yaw_from = 1 + scalars["lateral"]
    return FilledCells(
        parameter_key=scalars["parameter_key"],
        edges=edges,
        groups=groups,
        cells=np.flatnonzero(filled),
        weight=rows[:, 0],
        lateral=rows[:, 1:yaw_from],
        yaw=rows[:, yaw_from:],
        samples=scalars["samples"],
        windows=scalars["windows"],
    )


def pack_rolling_sums(parts: Sequence[RollingSums]) -> bytes:
    """Return what a window says of its rolling radius as one blob."""
    names = ("products", "noise")
    arrays = {name: np.array([getattr(part, name) for part in parts], dtype=np.float64) for name in names}
    return pack(ROLLING_SUMS, {}, arrays)


def unpack_rolling_sums(blob: bytes, *, where: str) -> tuple[RollingSums, ...]:
    """Return the sums of each part of a window, bit for bit."""
    _, arrays = unpack(blob, ROLLING_SUMS, where=where)
    return tuple(RollingSums(*both) for both in zip(arrays["products"], arrays["noise"], strict=True))


def pack_window_adhesion(creep: WindowAdhesion) -> bytes:
    """Return the creep of a window as one blob."""
    scalars, _ = fields_of(creep, without={"sums"})
    arrays = {} if creep.sums is None else fields_of(creep.sums)[1]
    return pack(WINDOW_ADHESION, scalars, arrays)


def unpack_window_adhesion(blob: bytes, *, where: str) -> WindowAdhesion:
    """Return the creep of a window, bit for bit."""
    scalars, arrays = unpack(blob, WINDOW_ADHESION, where=where)
    sums = value_of(FrictionSums, {}, arrays) if arrays else None
    return value_of(WindowAdhesion, scalars, {}, sums=sums)


def pack_window_damper(damper: WindowDamper) -> bytes:
    """Return what a window says as one blob; the products are symmetric, and half of them is kept."""
    scalars, _ = fields_of(damper, without={"sums"})
    if damper.sums is None:
        return pack(WINDOW_DAMPER, scalars, {})
    products = damper.sums.products
    rows, columns = np.tril_indices(products.shape[-1])
    scalars |= {"samples": float(damper.sums.samples).hex(), "curved": damper.sums.curved}
    return pack(WINDOW_DAMPER, scalars, {"products": products[:, rows, columns]})


def unpack_window_damper(blob: bytes, *, where: str) -> WindowDamper:
    """Return what a window says, bit for bit."""
    scalars, arrays = unpack(blob, WINDOW_DAMPER, where=where)
    if not arrays:
        return value_of(WindowDamper, scalars, {}, sums=None)
    half = arrays["products"]
    size = round((np.sqrt(8.0 * half.shape[-1] + 1.0) - 1.0) / 2.0)
    rows, columns = np.tril_indices(size)
    products = np.zeros((len(half), size, size))
    products[:, rows, columns] = half
    products[:, columns, rows] = half
    sums = DamperSums(products, float.fromhex(scalars["samples"]), scalars["curved"])
    return value_of(WindowDamper, scalars, {}, sums=sums)


def pack_signatures(signatures: Sequence[Signature]) -> bytes:
    """Return the signatures of a window as one blob."""
    if not signatures:
        return pack(SIGNATURES, {}, {})
    places = [signature.place for signature in signatures]
    scalars: dict[str, JsonValue] = {
        "vehicle": signatures[0].vehicle,
        "vehicle_class": signatures[0].vehicle_class,
        "position": signatures[0].position.value,
        "places": [None if place is None else [place.section, place.cell] for place in places],
    }
    arrays = {
        "order": np.array([signature.order for signature in signatures], dtype=np.int64),
        "speed": np.array([signature.speed for signature in signatures]),
        "peak_wavelength": np.array([signature.peak_wavelength for signature in signatures]),
        "spectra": np.stack([signature.spectra for signature in signatures]),
    }
    return pack(SIGNATURES, scalars, arrays)


def unpack_signatures(blob: bytes, wheelset: str, start_ns: int) -> tuple[Signature, ...]:
    """Return the signatures of a window, bit for bit."""
    scalars, arrays = unpack(blob, SIGNATURES, where=f"signatures of {wheelset}@{start_ns}")
    if not arrays:
        return ()
    return tuple(
        Signature(
            wheelset=wheelset,
            vehicle=scalars["vehicle"],
            vehicle_class=scalars["vehicle_class"],
            position=AxlePosition(scalars["position"]),
            start_ns=start_ns,
            order=int(arrays["order"][number]),
            place=None if place is None else Place(*place),
            speed=float(arrays["speed"][number]),
            spectra=arrays["spectra"][number],
            peak_wavelength=float(arrays["peak_wavelength"][number]),
        )
        for number, place in enumerate(scalars["places"])
    )


def to_document(row: WorklistRow) -> str:
    """Return a row of the worklist as JSON."""
    return orjson.dumps(to_json(row)).decode()


def from_document(document: str) -> WorklistRow:
    """Return the row of a JSON text that :func:`to_document` made."""
    return cast("WorklistRow", from_json(orjson.loads(document), WorklistRow))
