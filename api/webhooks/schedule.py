"""When an event that was not taken is sent again, and when it is given up: a pure function of its attempts."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC
from email.utils import parsedate_to_datetime

SECOND_NS = 1_000_000_000
LONGEST_DIGITS = 9


@dataclass(frozen=True, slots=True)
class Schedule:
    """Delays that grow from attempt to attempt; an event is given up when it was tried for long and often enough.

    Attributes:
        first_s, factor, longest_s: First delay, what each is times the one before, and the longest, s.
        jitter_1: Share by which a delay is made shorter or longer at random: receivers that failed together are not
            asked together.
        span_s, least_attempts: An event is given up after an attempt that fails so long after the first, s, and only
            after so many: a service that was off for days does not give up what it has hardly tried.
        longest_asked_s: What a receiver may ask for by ``Retry-After``, s.
    """

    first_s: float = 5.0
    factor: float = 3.0
    longest_s: float = 28_800.0
    jitter_1: float = 0.2
    span_s: float = 259_200.0
    least_attempts: int = 10
    longest_asked_s: float = 43_200.0

    def next_ns(
        self, first_ns: int, attempts: int, now_ns: int, chance_1: float, asked_s: float | None = None
    ) -> int | None:
        """Return when an event is sent again; None where it is given up.

        Args:
            chance_1: Of a fair draw from 0 to 1, for the jitter.
        """
        end_ns = first_ns + round(self.span_s * SECOND_NS)
        if now_ns >= end_ns and attempts >= self.least_attempts:
            return None
        delay_s = min(self.first_s * self.factor ** min(attempts - 1, 64), self.longest_s)
        delay_s *= 1.0 + self.jitter_1 * (2.0 * chance_1 - 1.0)
        if asked_s is not None:
            delay_s = max(delay_s, min(asked_s, self.longest_asked_s))
        after_ns = now_ns + round(delay_s * SECOND_NS)
        return min(after_ns, end_ns) if now_ns < end_ns else after_ns


def asked_delay_s(retry_after: str | None, now_ns: int) -> float | None:
    """Return how long a receiver asks to wait, in seconds; None where it says nothing that can be understood."""
    text = (retry_after or "").strip()
    if text.isascii() and text.isdecimal():
        return float(text[:LONGEST_DIGITS]) if len(text) <= LONGEST_DIGITS else float(10**LONGEST_DIGITS)
    try:
        moment = parsedate_to_datetime(text)
        asked_ns = moment.replace(tzinfo=moment.tzinfo or UTC).timestamp() * SECOND_NS
    except (ValueError, TypeError, OverflowError):
        return None
    return max(0.0, (asked_ns - now_ns) / SECOND_NS)
