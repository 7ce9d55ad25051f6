"""What a worker may work on for a while."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

MOST_ENDED = 3
"""Workers that end at one thing before it is set aside."""


@dataclass(frozen=True, slots=True)
class Claimed:
    """What came of asking for some things.

    Attributes:
        keys: Of those that may be worked on under the lease.
        ended: Of those at which workers have ended: by key, how many. They are free, and to be asked for one by one.
        elsewhere: How many are worked on under other leases.
        begun_ns: When work on each of ``keys`` was begun, ns by the clock of the claims.
    """

    keys: tuple[str, ...]
    ended: tuple[tuple[str, int], ...] = ()
    elsewhere: int = 0
    begun_ns: Mapping[str, int] = field(default_factory=dict)
