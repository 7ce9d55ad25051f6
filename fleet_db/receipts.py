"""The receipt of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from estimation.values.fields import Served
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

    digest: Annotated[str, Served("SHA-256 of its bytes: its identity.", example="ab" * 32)]
    vehicle: Annotated[str, Served("Code of the vehicle that it came for; it need not be registered.")]
    suffix: Annotated[str, Served("Ending of its format.", "format", example=".blf")]
    size_bytes: Annotated[int, Served("Of its bytes as they came.")]
    state: ChunkState
    reason: Reason | None
    first_ns: Annotated[int | None, Served("First frame, on the vehicle's clock; null until decoded.", "measured_from")]
    last_ns: Annotated[int | None, Served("Last frame, on the vehicle's clock; null until decoded.", "measured_to")]
    frames: int
    counts: Mapping[str, int]  # marked and counted: unknown identifiers, wrong lengths, gaps, clipped, invalid ...
    received_ns: Annotated[int, Served("When its receipt was given, by our clock.")]
    recorded_ns: int
    purged_ns: Annotated[
        int | None, Served("When its raw bytes were removed; null while they are kept.", "bytes_removed_at")
    ] = None
    clock_checked_ns: int | None = None  # our time against which the vehicle's is checked where received_ns was wrong
    file_name: Annotated[str | None, Served("Under which it came.")] = None
    sender: str | None = None  # who sent it where it came by HTTP or through a drop folder

    @property
    def our_ns(self) -> int:
        """Our time at which the vehicle had made it."""
        return self.received_ns if self.clock_checked_ns is None else self.clock_checked_ns


@dataclass(frozen=True, slots=True)
class EstimatedAgain:
    """What is estimated again because the class of vehicles, or the nominal radius of a wheelset, has changed.

    Attributes:
        from_ns: Start of the oldest of their windows, ns UTC on the vehicle's clock; None where there is none.
    """

    subjects: tuple[str, ...] = ()  # codes of the vehicles, or the wheelset, of which something is
    windows: int = 0  # how many of their windows; 0 where only geometries are
    from_ns: int | None = None
    sections: tuple[str, ...] = ()  # codes of the sections whose alignment is estimated from the begin


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
    action: Annotated[RecordingAction, Served("What was done.")]
    recorded_ns: Annotated[int, Served("When, by our clock.", "at")]
    actor: Annotated[str, Served("Who.", "by")]
    why: Annotated[str, Served("As it was written.")]
    vehicle_before: Annotated[str, Served("Code of its vehicle before it.")]
    state_before: Annotated[ChunkState, Served("Its state before it.")]
    vehicle_after: Annotated[str, Served("Code of its vehicle after it.")]
    state_after: Annotated[ChunkState, Served("Its state after it.")]
