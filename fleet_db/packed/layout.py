"""The arrays of a track layout packed."""

from __future__ import annotations

from estimation.values.track import TrackLayout
from fleet_db.packing import pack, unpack

KIND = "track_layout"
VERSION = 1
ARRAYS = ("s", "curvature", "cant")


def pack_layout(layout: TrackLayout) -> bytes:
    """Return ``layout`` as one blob, without its version, so that the same content is the same blob."""
    return pack(KIND, VERSION, {"section": layout.section}, {name: getattr(layout, name) for name in ARRAYS})


def unpack_layout(blob: bytes, version: int, *, where: str) -> TrackLayout:
    """Return the layout as ``version``, bit for bit.

    Raises
    ------
    DamagedError
        The blob is damaged; ``where`` names it.
    """
    packed = unpack(blob, KIND, where=where)
    return TrackLayout(section=packed.scalars["section"], version=version, **packed.arrays)
