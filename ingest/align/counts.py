"""What alignment met and did not hide."""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True, slots=True)
class AlignCounts:
    """Counts over one recording. Frames that are left out of windows are in exactly one of the reasons."""

    time_frames: int = 0
    clock_jumps: int = 0  # pairs of TIME frames that disagree
    syncs: int = 0
    syncs_missing: int = 0  # numbers that no SYNC carried, between two that did
    syncs_unplaced: int = 0  # no TIME frame near, a clock jump, or a counter out of phase with the clock
    samples: int = 0
    frames_without_sync: int = 0  # no SYNC with a known number in reach
    duplicate_frames: int = 0  # the same frame again at the same instant
    conflicting_frames: int = 0  # another payload at the same instant: both are invalid
    samples_lost: int = 0  # by the nodes' sample counters
    counter_resets: int = 0
    counter_mismatches: int = 0  # more frames than the node says it sent: invalid
    emergencies: int = 0
    self_test_failures: int = 0

    def __add__(self, other: AlignCounts) -> AlignCounts:
        mine, theirs = asdict(self), asdict(other)
        return AlignCounts(**{name: mine[name] + theirs[name] for name in mine})
