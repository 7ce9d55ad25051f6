"""How long to wait before the next attempt."""

from __future__ import annotations


class Backoff:
    """Delays that double from attempt to attempt, until one succeeds."""

    def __init__(self, first_s: float, longest_s: float) -> None:
        self._first_s = first_s
        self._longest_s = longest_s
        self._next_s = first_s

    def failed(self) -> float:
        """Return how long to wait after an attempt that failed, s."""
        delay_s = self._next_s
        self._next_s = min(2.0 * delay_s, self._longest_s)
        return delay_s

    def succeeded(self) -> None:
        """Begin with the first delay again."""
        self._next_s = self._first_s
