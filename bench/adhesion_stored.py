"""The passes of a case of the adhesion bench on disk: pooling and decision are judged again without simulating."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.opinions import WindowAdhesion
from fleet_db.packed_values import pack_window_adhesion, unpack_window_adhesion


@dataclass(frozen=True, slots=True)
class StoredPasses:
    """What the windows of a case say of friction, and what is true."""

    section: str
    passes: tuple[WindowAdhesion, ...]
    distance: FloatArray  # (n,) m
    friction: FloatArray  # (n,) true coefficient there
    length: float  # m, of the section


def path_of(folder: Path, row: str, seed: int) -> Path:
    """Return the file of a case."""
    return folder / f"{row}-{seed}.npz"


def write_passes(path: Path, stored: StoredPasses) -> None:
    """Write the passes of a case."""
    blobs = [pack_window_adhesion(one) for one in stored.passes]
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        path,
        section=np.array(stored.section),
        lengths=np.array([len(blob) for blob in blobs]),
        blobs=np.frombuffer(b"".join(blobs), np.uint8),
        distance=stored.distance,
        friction=stored.friction,
        length=np.array(stored.length),
    )


def read_passes(path: Path) -> StoredPasses:
    """Read what ``write_passes`` wrote."""
    with np.load(path) as stored:
        blobs, ends = stored["blobs"].tobytes(), np.cumsum(stored["lengths"])
        passes = tuple(
            unpack_window_adhesion(blobs[end - length : end], where=str(path))
            for end, length in zip(ends, stored["lengths"], strict=True)
        )
        return StoredPasses(
            str(stored["section"]), passes, stored["distance"], stored["friction"], float(stored["length"])
        )
