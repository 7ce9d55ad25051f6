"""What reading one log file may cost: memory, CPU, waiting, frames, span of time; by the size of the file."""

from __future__ import annotations

from dataclasses import dataclass

MEBIBYTE = 1 << 20
DAY_NS = 86_400_000_000_000

BASE_CPU_S = 8.0
BASE_WALL_S = 9.5
BASE_FRAMES = 1_000_000
FRAMES_PER_BYTE = 0.5
"""A BLF file of a standing vehicle whose sensors send one value takes 4 bytes a frame, a running one 15."""

BASE_INFLATED = 64 * MEBIBYTE
INFLATED_PER_BYTE = 24


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """Bounds on reading one log file."""

    memory_bytes: int = 128 * MEBIBYTE  # that the process may take beyond what it begins with
    cpu_s: float = BASE_CPU_S
    wall_s: float = BASE_WALL_S
    frames: int = BASE_FRAMES
    inflated_bytes: int = BASE_INFLATED  # of all containers together
    container_bytes: int = 16 * MEBIBYTE  # of one container, inflated, and of one object
    span_ns: int = 31 * DAY_NS  # from the first stamp to the last


def limits_of(size_bytes: int, bytes_per_s: int, more_memory: int = 0) -> ReadLimits:
    """Return the limits for a file: a day of a vehicle passes with room to spare, a bomb does not.

    Memory does not grow with the file, because no reader keeps more of it than a few containers or lines.

    Args:
        bytes_per_s: What its reader reads at least.
        more_memory: Bytes that reading the format needs beyond those of every format.
    """
    seconds = size_bytes / bytes_per_s
    return ReadLimits(
        memory_bytes=ReadLimits().memory_bytes + more_memory,
        cpu_s=BASE_CPU_S + seconds,
        wall_s=BASE_WALL_S + 2.0 * seconds,
        frames=BASE_FRAMES + round(FRAMES_PER_BYTE * size_bytes),
        inflated_bytes=BASE_INFLATED + INFLATED_PER_BYTE * size_bytes,
    )
