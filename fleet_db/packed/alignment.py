"""The arrays of a track alignment packed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from estimation.alerts import JsonValue
from estimation.types import RECORDED, Status, TrackAlignment
from fleet_db.packed.numbers import number_to_json, real_from_json
from fleet_db.packing import pack, unpack

KIND = "track_alignment"
VERSION = 2
OF_RECORDINGS = 1  # says nothing of source, cut-off, scale and gauge: all of it is known
ARRAYS = ("s", "alignment", "alignment_std", "gauge_deviation", "gauge_deviation_std", "passes")


def pack_alignment(alignment: TrackAlignment) -> bytes:
    """Return ``alignment`` as one blob, without its version, so that the same content is the same blob."""
    arrays = {name: getattr(alignment, name) for name in ARRAYS}
    scalars: dict[str, JsonValue] = {"section": alignment.section, "status": str(alignment.status)}
    if (alignment.source, alignment.cut_off, alignment.scale_std, alignment.gauge_known) == (RECORDED, np.inf, 0, True):
        return pack(KIND, OF_RECORDINGS, scalars, arrays)
    told: dict[str, JsonValue] = {
        "source": alignment.source,
        "cut_off": number_to_json(alignment.cut_off),
        "scale_std": number_to_json(alignment.scale_std),
        "gauge_known": alignment.gauge_known,
    }
    return pack(KIND, VERSION, scalars | told, arrays)


def unpack_alignment(blob: bytes, version: int, *, where: str) -> TrackAlignment:
    """Return the alignment as ``version``, bit for bit.

    Raises
    ------
    StorageError
        The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, KIND, where=where)
    scalars = packed.scalars
    arrays: dict[str, Any] = dict(packed.arrays)
    found = TrackAlignment(section=scalars["section"], version=version, status=Status(scalars["status"]), **arrays)
    if packed.version == OF_RECORDINGS:
        return found
    return replace(
        found,
        source=scalars["source"],
        cut_off=real_from_json(scalars["cut_off"]),
        scale_std=real_from_json(scalars["scale_std"]),
        gauge_known=scalars["gauge_known"],
    )
