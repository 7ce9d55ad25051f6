"""How much a log file may cost to read."""

from __future__ import annotations

from dataclasses import dataclass

MEBIBYTE = 1 << 20


@dataclass(frozen=True, slots=True)
class ReadLimits:
    """Bounds on reading one log file; a day of one vehicle fits with room to spare, a bomb does not."""

    inflated_bytes: int = 1024 * MEBIBYTE  # of all containers together
    container_bytes: int = 16 * MEBIBYTE  # of one container, inflated
    frames: int = 50_000_000
    memory_bytes: int = 4096 * MEBIBYTE  # address space of the child process
    seconds: float = 600.0  # of the child process


DEFAULT_LIMITS = ReadLimits()
