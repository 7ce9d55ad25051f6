"""Samples of windows as files beside the database, addressed by their content.

A channel of accelerations that is whole counts of its resolution is stored as int16, any other bit for bit as float64.
Speed and distance are smooth: their bit patterns are stored as differences, which loses nothing and packs well.
A window file can be made again from the raw recordings, so it is renamed into place but not forced to the disk.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from estimation.errors import DamagedError, StorageError
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.fields import JsonValue
from estimation.values.windows import ACCELERATIONS, NO_BLOWS, NOT_HUNTING, Hunting, TurnBlows, Window, WindowQuality
from fleet_db.atomic_files import passing_fault, passing_faults, write_atomically
from fleet_db.fields import Array, from_json, pack, to_json, unpack

KIND = "window"
MISSING, LARGEST_COUNT = -32768, 32767
SMOOTH = ("speed", "distance")
PLAIN = ("wheelset", "vehicle", "axle", "start_ns", "length_ns", "track_section")
QUALITY = tuple(item.name for item in fields(WindowQuality) if item.name not in ("hunting", "blows"))
QUALITY_COUNTS = ("gaps", "sensor_fault")


@dataclass(frozen=True, slots=True)
class WindowFiles:
    """Window files under one directory."""

    directory: Path

    def path(self, digest: str) -> Path:
        """Return where the window of this content is."""
        return self.directory / digest[:2] / f"{digest}.window"

    def has(self, digest: str, size: int) -> bool:
        """Whether the file is there with the size it was written with."""
        try:
            return self.path(digest).stat().st_size == size
        except FileNotFoundError:
            return False

    def save(self, window: Window, digest: str) -> int:
        """Write the file of ``window``, whose content digest is ``digest``; return its size in bytes."""
        blob = pack_window(window)
        path = self.path(digest)
        with passing_faults(path):
            with suppress(FileNotFoundError):
                os.utime(path)  # no purge takes it for an orphan before its row is committed
            if not self.has(digest, len(blob)):
                write_atomically(path, blob, durable=False)
        return len(blob)

    def load(self, digest: str) -> Window:
        """Return the window, bit for bit; StorageError: no folder, PassingFaultError: not now, DamagedError: ever."""
        path = self.path(digest)
        try:
            blob = path.read_bytes()
        except FileNotFoundError as error:
            if not self.directory.is_dir():  # a disk that is not mounted is no damage to one window
                raise StorageError(f"{self.directory}: the directory of the windows is not there") from error
            raise DamagedError(f"{path}: the samples of a window are missing") from error
        except OSError as error:
            if not os.access(self.directory, os.R_OK | os.X_OK):  # no window can be read now
                raise StorageError(f"{self.directory}: cannot be used: {error.strerror}") from error
            raise passing_fault(error, path) from error
        window = unpack_window(blob, where=str(path))
        if window_digest(window) != digest:
            raise DamagedError(f"{path}: holds other content than its name says")
        return window


def window_digest(window: Window) -> str:
    """Return the sha256 over every field of ``window``, independent of how it is stored."""
    digest = hashlib.sha256(json.dumps(_scalars(window), sort_keys=True, separators=(",", ":")).encode())
    for name in (*ACCELERATIONS, *SMOOTH):
        digest.update(getattr(window, name).astype("<f8", copy=False))
    digest.update(window.valid.data)
    return digest.hexdigest()


def pack_window(window: Window) -> bytes:
    """Return ``window`` as one blob."""
    channels = {
        name: _counts(getattr(window, name), step) for name, step in zip(ACCELERATIONS, window.resolution, strict=True)
    }
    smooth = {name: np.diff(getattr(window, name).view(np.int64), prepend=np.int64(0)) for name in SMOOTH}
    valid = {"valid": np.packbits(window.valid)}
    return pack(KIND, _scalars(window), {**channels, **smooth, **valid})


def unpack_window(blob: bytes, *, where: str) -> Window:
    """Return the window, bit for bit."""
    scalars, arrays = unpack(blob, KIND, where=where)
    steps: Any = from_json(scalars["resolution"], tuple[float, ...])
    values: dict[str, Any] = {
        name: _from_counts(arrays[name], step) for name, step in zip(ACCELERATIONS, steps, strict=True)
    }
    values |= {name: np.cumsum(arrays[name]).view(np.float64) for name in SMOOTH}
    valid: BoolArray = np.unpackbits(arrays["valid"], count=len(values["speed"])).astype(bool)
    for array in (*values.values(), valid):
        array.flags.writeable = False
    return Window(
        **{name: scalars[name] for name in PLAIN},
        sample_interval_s=from_json(scalars["sample_interval_s"], float),
        odometer_m=from_json(scalars["odometer_m"], float),
        **values,
        valid=valid,
        resolution=steps,
        quality=_quality(scalars["quality"], scalars.get("hunting"), scalars.get("blows")),
    )


def _counts(values: FloatArray, step: float) -> Array:
    """Return whole counts, NaN as missing, where they give back the same bits, else the values as they are."""
    with np.errstate(invalid="ignore", over="ignore"):
        counts = np.rint(values / step)
        packed = np.where(np.abs(counts) <= LARGEST_COUNT, counts, MISSING).astype(np.int16)
        back = _from_counts(packed, step)
    return packed if np.array_equal(back.view(np.int64), values.view(np.int64)) else values


def _from_counts(packed: Array, step: float) -> FloatArray:
    if packed.dtype != np.int16:
        return packed
    return np.where(packed == MISSING, np.nan, packed * np.float64(step))


def _scalars(window: Window) -> dict[str, Any]:
    return {
        **{name: to_json(getattr(window, name)) for name in (*PLAIN, "sample_interval_s", "odometer_m", "resolution")},
        "quality": {name: _to_json(name, getattr(window.quality, name)) for name in QUALITY},
        # only where there is some
        **({"hunting": to_json(window.quality.hunting)} if window.quality.hunting.share else {}),
        **({"blows": to_json(window.quality.blows)} if window.quality.blows.share else {}),
    }


def _to_json(name: str, value: float) -> JsonValue:
    return value if name in QUALITY_COUNTS else to_json(float(value))


def _quality(stored: Mapping[str, Any], hunting: Any, blows: Any) -> WindowQuality:  # noqa: ANN401 - JSON
    numbers: dict[str, Any] = {
        name: value if name in QUALITY_COUNTS else from_json(value, float) for name, value in stored.items()
    }
    hunted: Hunting = NOT_HUNTING if hunting is None else from_json(hunting, Hunting)
    struck: TurnBlows = NO_BLOWS if blows is None else from_json(blows, TurnBlows)
    return WindowQuality(**numbers, hunting=hunted, blows=struck)
