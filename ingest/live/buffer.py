"""Frames between the thread that listens and the one that writes: bounded, and what does not fit is counted."""

from __future__ import annotations

import threading

from ingest.live.records import FRAME_BYTES


class FrameBuffer:
    """Frames in memory, oldest first. When it is full the newest are dropped."""

    def __init__(self, limit_bytes: int) -> None:
        self._limit = limit_bytes
        self._lock = threading.Lock()
        self._frames = bytearray()
        self._dropped = 0
        self._handed_over = 0

    @property
    def dropped(self) -> int:
        """Frames dropped since the start."""
        return self._dropped

    @property
    def size_bytes(self) -> int:
        """Bytes that wait."""
        return len(self._frames)

    def add(self, frame: bytes) -> None:
        """Keep a packed frame, or count it as dropped; never waits for a disk."""
        with self._lock:
            if len(self._frames) + FRAME_BYTES <= self._limit:
                self._frames += frame
            else:
                self._dropped += 1

    def count_dropped(self, frames: int) -> None:
        """Count frames that were dropped before they came here."""
        with self._lock:
            self._dropped += frames

    def take(self, limit_bytes: int) -> tuple[bytes, int]:
        """Return the oldest frames, and how many were dropped behind them.

        Args:
            limit_bytes: How much to take at most; a multiple of the size of a frame.
        """
        with self._lock:
            frames = bytes(self._frames[:limit_bytes])
            del self._frames[:limit_bytes]
            if self._frames or not frames:
                return frames, 0
            dropped = self._dropped - self._handed_over
            self._handed_over = self._dropped
            return frames, dropped
