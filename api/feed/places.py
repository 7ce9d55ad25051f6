"""Places for those who wait for news: so many in a process, and of one key what access allows."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum

from prometheus_client.core import Metric

from api.access.caller import Caller
from api.access.rates import StreamPlaces
from api.measures import gauge
from api.problems import ProblemError

TRY_AGAIN = {"Retry-After": "10"}


class Waits(StrEnum):
    """How a client waits."""

    STREAM = "stream"
    LONG_POLL = "long_poll"


class WaitingPlaces:
    """Counts who waits, refuses who would be too many, and shows it to Prometheus."""

    def __init__(self, limit: int, of_keys: StreamPlaces) -> None:
        self._limit = limit
        self._of_keys = of_keys
        self._waiting: Counter[Waits] = Counter()

    @contextmanager
    def held(self, how: Waits, caller: Caller) -> Iterator[None]:
        """Hold a place."""
        if sum(self._waiting.values()) >= self._limit:
            detail = f"limit max_streams: {self._limit} clients wait for news; try again"
            raise ProblemError(503, "overloaded", detail, headers=TRY_AGAIN)
        with self._of_keys.place(caller):
            self._waiting[how] += 1
            try:
                yield
            finally:
                self._waiting[how] -= 1

    def measures(self) -> list[Metric]:
        """Return how many wait now, for Prometheus."""
        waiting = {how.value: self._waiting[how] for how in Waits}
        return [gauge("treadwatch_feed_waiting", "Clients that wait for news of the feed.", "how", waiting)]
