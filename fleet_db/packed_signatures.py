"""Wear signatures of a window as one blob: arrays of all of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimation.values.fields import JsonValue
from estimation.values.signatures import AxlePosition, Place, Signature
from fleet_db.fields import pack, unpack

VERSION = 1
SIGNATURES = "wear_signatures"


def pack_signatures(found: Sequence[Signature]) -> bytes:
    """Return the signatures of a window as one blob."""
    if not found:
        return pack(SIGNATURES, VERSION, {}, {})
    scalars: dict[str, JsonValue] = {
        "vehicle": found[0].vehicle,
        "vehicle_class": found[0].vehicle_class,
        "position": found[0].position.value,
        "places": [None if one.place is None else [one.place.section, one.place.cell] for one in found],
    }
    arrays = {
        "order": np.array([one.order for one in found], dtype=np.int64),
        "speed": np.array([one.speed for one in found]),
        "peak_wavelength": np.array([one.peak_wavelength for one in found]),
        "spectra": np.stack([one.spectra for one in found]),
    }
    return pack(SIGNATURES, VERSION, scalars, arrays)


def unpack_signatures(blob: bytes, wheelset: str, start_ns: int) -> tuple[Signature, ...]:
    """Return the signatures of a window, bit for bit.

    Args:
        blob: From ``pack_signatures``.

    Raises:
        StorageError: The blob is damaged.
    """
    packed = unpack(blob, SIGNATURES, where=f"signatures of {wheelset}@{start_ns}")
    if not packed.arrays:
        return ()
    scalars, arrays = packed.scalars, packed.arrays
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
