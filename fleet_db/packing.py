"""Named arrays in one blob: versioned header, byte shuffle, zstd; every bit comes back.

Layout (little endian): ``TWPK``, format version (u8), zstd frame with content checksum. Inside the frame: length of
the header (u32), header (JSON: kind, its version, scalars, and name, dtype and shape of each array), then the arrays
one after the other, each shuffled so that equal bytes of neighbouring numbers lie together.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import zstandard

from estimation.errors import DamagedError
from estimation.values.json_value import JsonValue

MAGIC = b"TWPK"
FORMAT = 1
LEVEL = 1
DTYPES: Mapping[str, np.dtype[Any]] = {
    "<f8": np.dtype("<f8"),
    "<i8": np.dtype("<i8"),
    "<i2": np.dtype("<i2"),
    "|u1": np.dtype("|u1"),
}
LARGEST = 1 << 30  # bytes that a blob may unfold to

Array = npt.NDArray[Any]


@dataclass(frozen=True, slots=True)
class Unpacked:
    """What was packed."""

    version: int
    scalars: Mapping[str, Any]
    arrays: Mapping[str, Array]


def pack(kind: str, version: int, scalars: Mapping[str, JsonValue], arrays: Mapping[str, Array]) -> bytes:
    """Return one blob of ``arrays`` and ``scalars``.

    Args:
        kind, version: What the blob is, and the version of that layout; ``unpack`` insists on the kind.
        scalars: Anything JSON holds except NaN and infinity (numbers that may be one go into an array).
        arrays: float64, int64, int16 or uint8, of any shape.
    """
    described = [[name, _little(array).dtype.str, list(array.shape)] for name, array in arrays.items()]
    header = json.dumps(
        {"kind": kind, "version": version, "scalars": dict(scalars), "arrays": described},
        separators=(",", ":"),
        allow_nan=False,
    ).encode()
    body = b"".join([struct.pack("<I", len(header)), header, *(_shuffled(array) for array in arrays.values())])
    compressor = zstandard.ZstdCompressor(level=LEVEL, write_checksum=True)
    return MAGIC + bytes([FORMAT]) + compressor.compress(body)


def unpack(blob: bytes, kind: str, *, where: str) -> Unpacked:
    """Return what ``pack`` put into ``blob``; arrays are read-only.

    Args:
        blob: From ``pack``.
        kind: What the blob must be.
        where: Name of the place it was read from, for messages.

    Raises:
        DamagedError: The blob is cut, damaged, or of another kind or a later format; ``where`` names it.
    """
    if blob[: len(MAGIC)] != MAGIC or blob[len(MAGIC) : len(MAGIC) + 1] != bytes([FORMAT]):
        raise DamagedError(f"{where}: not packed arrays of format {FORMAT}")
    try:
        body = _unfolded(blob[len(MAGIC) + 1 :])
        (length,) = struct.unpack_from("<I", body)
        header = json.loads(body[4 : 4 + length])
        arrays = _arrays(body, 4 + length, header["arrays"])
    except (zstandard.ZstdError, struct.error, ValueError, KeyError, TypeError) as error:
        raise DamagedError(f"{where}: damaged ({error})") from error
    if header["kind"] != kind:
        raise DamagedError(f"{where}: holds {header['kind']!r}, expected {kind!r}")
    return Unpacked(header["version"], header["scalars"], arrays)


def _unfolded(frame: bytes) -> bytes:
    size = zstandard.frame_content_size(frame)
    if not 0 <= size <= LARGEST:
        raise ValueError(f"claims to unfold to {size} bytes")
    return zstandard.ZstdDecompressor().decompress(frame)


def _little(array: Array) -> Array:
    little = array.astype(array.dtype.newbyteorder("<"), copy=False)
    if little.dtype.str not in DTYPES:
        raise TypeError(f"arrays of {array.dtype} are not packed")
    return little


def _shuffled(array: Array) -> bytes:
    """Return all first bytes of the numbers, then all second bytes, and so on."""
    little = np.ascontiguousarray(_little(array)).reshape(-1)
    if little.itemsize == 1:
        return little.tobytes()
    return little.view(np.uint8).reshape(-1, little.itemsize).T.tobytes()


def _arrays(body: bytes, at: int, described: list[list[Any]]) -> dict[str, Array]:
    found: dict[str, Array] = {}
    for name, code, shape in described:
        dtype: np.dtype[Any] = DTYPES[code]
        count = math.prod(shape)
        size = count * dtype.itemsize
        raw = np.frombuffer(body, np.uint8, size, at)
        numbers = np.empty((count, dtype.itemsize), np.uint8)
        for place, one_byte in enumerate(raw.reshape(dtype.itemsize, count)):  # a fifth of what transposing takes
            numbers[:, place] = one_byte
        array = numbers.reshape(-1).view(dtype).reshape(shape)
        array.flags.writeable = False
        found[name] = array
        at += size
    if at != len(body):
        raise ValueError(f"{len(body) - at} bytes left over")
    return found
