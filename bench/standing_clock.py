"""A clock for deployments that run for real in a past of their own."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class StandingClock:
    """Stands where it is put, and goes on by a millisecond at each look, as recorded times must."""

    at_ns: int

    def now_ns(self) -> int:
        """Return nanoseconds UTC."""
        self.at_ns += 1_000_000
        return self.at_ns
