"""The receipt of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from estimation.values.reasons import Reason


class ChunkState(StrEnum):
    """Where a recording stands on its way to windows."""

    STORED = "stored"  # its bytes are safe
    DECODED = "decoded"
    REJECTED = "rejected"
    SET_ASIDE = "set_aside"  # by hand: its frames count for no window
    DELETED = "deleted"  # by hand: as if it had never come; its receipt stays, its bytes do not


@dataclass(frozen=True, slots=True)
class ChunkRecord:
    """The receipt of a recording: raw bytes are stored under their digest before this row is committed."""

    digest: str  # sha256 of the raw bytes
    vehicle: str
    suffix: str  # ".blf", ".asc", ".log", ".mf4"
    size_bytes: int
    state: ChunkState
    reason: Reason | None
    first_ns: int | None  # vehicle clock, once decoded
    last_ns: int | None
    frames: int
    counts: Mapping[str, int]  # marked and counted: unknown identifiers, wrong lengths, gaps, clipped, invalid ...
    received_ns: int
    recorded_ns: int
    purged_ns: int | None = None  # our time at which its raw bytes were deleted; its windows stay as they are
    clock_checked_ns: int | None = None  # our time against which the vehicle's is checked where received_ns was wrong
    file_name: str | None = None  # under which it came
    sender: str | None = None  # who sent it where it came by HTTP or through a drop folder

    @property
    def our_ns(self) -> int:
        """Our time at which the vehicle had made it."""
        return self.received_ns if self.clock_checked_ns is None else self.clock_checked_ns


@dataclass(frozen=True, slots=True)
class EstimatedAgain:
    """What is estimated again because the class of vehicles, or the nominal radius of a wheelset, has changed.

    Attributes:
        subjects: Codes of the vehicles, or the wheelset, of which something is.
        windows: How many of their windows; 0 where only geometries are.
        from_ns: Start of the oldest of their windows, ns UTC on the vehicle's clock; None where there is none.
        sections: Codes of the sections whose alignment is estimated from the begin.
    """

    subjects: tuple[str, ...] = ()
    windows: int = 0
    from_ns: int | None = None
    sections: tuple[str, ...] = ()


NOTHING_AGAIN = EstimatedAgain()


class RecordingAction(StrEnum):
    """What is done to a recording by hand."""

    RETRY = "retry"
    SET_ASIDE = "set_aside"
    RESTORE = "restore"
    REASSIGN = "reassign"
    DELETE = "delete"
    TAKE_AGAIN = "take_again"  # received again after it had been deleted, because that was asked for


@dataclass(frozen=True, slots=True)
class RecordingChange:
    """What was done to a recording by hand: when (our time), by whom and why, and how it stood before and after."""

    digest: str
    action: RecordingAction
    recorded_ns: int
    actor: str
    why: str
    vehicle_before: str
    state_before: ChunkState
    vehicle_after: str
    state_after: ChunkState
