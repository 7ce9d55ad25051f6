"""A wheelset geometry packed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from estimation.values.geometry import COMBINATIONS, BinStatus, BinValues, WheelsetGeometry
from estimation.values.quantities import Status
from fleet_db.packed.numbers import estimate_from_json, estimate_to_json, number_to_json, real_from_json
from fleet_db.packing import Array, pack, unpack

KIND = "wheelset_geometry"
VERSION = 1


def pack_geometry(geometry: WheelsetGeometry) -> bytes:
    """Return ``geometry`` as one blob."""
    combinations: dict[str, BinValues] = {name: getattr(geometry, name) for name in COMBINATIONS}
    return pack(
        KIND,
        VERSION,
        {
            "combinations": {name: [str(status) for status in values.status] for name, values in combinations.items()},
            "conicity": [estimate_to_json(estimate) for estimate in geometry.conicity],
            "headline_amplitude": number_to_json(geometry.reported_amplitude),
            "equivalent_conicity": estimate_to_json(geometry.equivalent_conicity),
            "nonlinearity": estimate_to_json(geometry.nonlinearity),
            "zero_crossing": estimate_to_json(geometry.zero_crossing),
            "windows": int(geometry.windows),
            "parameter_key": geometry.parameter_key,
            "status": str(geometry.status),
            "reason": geometry.reason,
        },
        {
            "bin_edges": geometry.bin_edges,
            "samples": geometry.samples,
            "amplitude": geometry.amplitude,
            "values": np.stack([values.value for values in combinations.values()]),
            "stds": np.stack([values.std for values in combinations.values()]),
        },
    )


def unpack_geometry(blob: bytes, *, where: str) -> WheelsetGeometry:
    """Return the geometry, bit for bit.

    Raises
    ------
    StorageError
        The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, KIND, where=where)
    scalars, arrays = packed.scalars, packed.arrays
    return WheelsetGeometry(
        bin_edges=arrays["bin_edges"],
        samples=arrays["samples"],
        **_combinations(scalars["combinations"], arrays),
        amplitude=arrays["amplitude"],
        conicity=tuple(estimate_from_json(fields) for fields in scalars["conicity"]),
        reported_amplitude=real_from_json(scalars["headline_amplitude"]),
        equivalent_conicity=estimate_from_json(scalars["equivalent_conicity"]),
        nonlinearity=estimate_from_json(scalars["nonlinearity"]),
        zero_crossing=estimate_from_json(scalars["zero_crossing"]),
        windows=scalars["windows"],
        parameter_key=scalars["parameter_key"],
        status=Status(scalars["status"]),
        reason=scalars["reason"],
    )


def _combinations(statuses: Mapping[str, Any], arrays: Mapping[str, Array]) -> dict[str, BinValues]:
    return {
        name: BinValues(value, std, tuple(BinStatus(status) for status in listed))
        for (name, listed), value, std in zip(statuses.items(), arrays["values"], arrays["stds"], strict=True)
    }
