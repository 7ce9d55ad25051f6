"""Limits of rate: a bucket of tokens for each key and each address, in the memory of one process."""

from __future__ import annotations

import math
from collections import Counter, OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from api.access.caller import Caller
from api.problems import ProblemError

BUCKETS = 10_000
"""Keys or addresses that are remembered; beyond, the one not seen for longest is forgotten."""


@dataclass(slots=True)
class _Bucket:
    tokens: float
    at_s: float


@dataclass(slots=True)
class Rate:
    """So many a second on average, and so many at once; for one thread."""

    per_s: float
    burst: float
    _buckets: OrderedDict[str, _Bucket] = field(default_factory=OrderedDict)

    def take(self, name: str, now_s: float) -> float | None:
        """Take one; return None, or after how many seconds there will be one."""
        bucket = self._filled(name, now_s)
        if bucket.tokens < 1.0:
            return math.ceil((1.0 - bucket.tokens) / self.per_s)
        bucket.tokens -= 1.0
        return None

    def wait_s(self, name: str, now_s: float) -> float | None:
        """Return after how many seconds there will be one to take; None where there is one now. Takes none."""
        tokens = self._filled(name, now_s).tokens
        return None if tokens >= 1.0 else math.ceil((1.0 - tokens) / self.per_s)

    def _filled(self, name: str, now_s: float) -> _Bucket:
        bucket = self._buckets.setdefault(name, _Bucket(self.burst, now_s))
        self._buckets.move_to_end(name)
        if len(self._buckets) > BUCKETS:
            self._buckets.popitem(last=False)
        bucket.tokens = min(self.burst, bucket.tokens + (now_s - bucket.at_s) * self.per_s)
        bucket.at_s = now_s
        return bucket


@dataclass(slots=True)
class StreamPlaces:
    """The places of one process; for one event loop."""

    per_key: int
    _held: Counter[str] = field(default_factory=Counter)

    @contextmanager
    def place(self, caller: Caller) -> Iterator[None]:
        """Hold a place for as long as a stream is open."""
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
