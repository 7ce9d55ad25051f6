"""How many streams one key may hold open at the same time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from api.access.caller import Caller
from api.problems import ProblemError


@dataclass(slots=True)
class StreamPlaces:
    """The places of one process; for one event loop.

    Args:
        per_key: Of each key; where access is open, there are no keys to count by.
    """

    per_key: int
    _held: Counter[str] = field(default_factory=Counter)

    @contextmanager
    def place(self, caller: Caller) -> Iterator[None]:
        """Hold a place for as long as a stream is open.

        Raises:
            ProblemError: 429: the key holds as many as it may.
        """
        name = caller.identity or ""
        if caller.identity is not None and self._held[name] >= self.per_key:
            detail = f"limit streams_per_key: at most {self.per_key} streams of a key; close one"
            raise ProblemError(429, "too-many-requests", detail, headers={"Retry-After": "10"})
        self._held[name] += 1
        try:
            yield
        finally:
            self._held[name] -= 1
            if not self._held[name]:
                del self._held[name]
