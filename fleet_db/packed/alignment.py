"""The arrays of a track alignment packed."""

from __future__ import annotations

from estimation.types import Status, TrackAlignment
from fleet_db.packing import pack, unpack

KIND = "track_alignment"
VERSION = 1
ARRAYS = ("s", "alignment", "alignment_std", "gauge_deviation", "gauge_deviation_std", "passes")


def pack_alignment(alignment: TrackAlignment) -> bytes:
    """Return ``alignment`` as one blob, without its version, so that the same content is the same blob."""
    scalars = {"section": alignment.section, "status": str(alignment.status)}
    return pack(KIND, VERSION, scalars, {name: getattr(alignment, name) for name in ARRAYS})


def unpack_alignment(blob: bytes, version: int, *, where: str) -> TrackAlignment:
    """Return the alignment as ``version``, bit for bit.

    Raises
    ------
    StorageError
        The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, KIND, where=where)
    return TrackAlignment(
        section=packed.scalars["section"],
        version=version,
        status=Status(packed.scalars["status"]),
        **packed.arrays,
    )
