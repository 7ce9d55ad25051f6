"""When an event is sent again: the schedule alone, over moved clocks."""

from __future__ import annotations

from itertools import pairwise

import pytest

from api.webhooks.delivering import Schedule, asked_delay_s

S = 1_000_000_000
DAY_S = 86_400
FIRST = 1_774_860_123 * S
NO_JITTER = 0.5


def _attempts(chance: float, asked_s: float | None = None, late_s: float = 0.0) -> list[float]:
    """Return when each attempt is made, in seconds after the first, while all fail."""
    schedule, now, times = Schedule(), FIRST, [0.0]
    while (after := schedule.next_ns(FIRST, len(times), now, chance, asked_s)) is not None:
        now = after + round(late_s * S)
        times.append((now - FIRST) / S)
        assert len(times) < 100
    return times


def test_the_delays_grow_to_8_hours_and_end_after_3_days() -> None:
    times = _attempts(NO_JITTER)
    delays = [after - before for before, after in pairwise(times)]
    assert delays[:9] == [5, 15, 45, 135, 405, 1215, 3645, 10935, 28800]
    assert set(delays[8:-1]) == {28800}
    assert times[-1] == 3 * DAY_S
    assert len(times) == 18


@pytest.mark.parametrize("chance", [0.0, 0.25, 1.0])
def test_jitter_moves_each_delay_by_a_fifth_at_most_and_never_the_end(chance: float) -> None:
    times = _attempts(chance)
    delays = [after - before for before, after in pairwise(times)]
    share = 1.0 + 0.2 * (2.0 * chance - 1.0)
    assert delays[:3] == pytest.approx([5 * share, 15 * share, 45 * share])
    assert times[-1] == 3 * DAY_S


def test_a_receiver_may_ask_for_more_time_but_not_for_ever() -> None:
    assert _attempts(NO_JITTER, asked_s=60.0)[:4] == [0, 60, 120, 180]
    assert _attempts(NO_JITTER, asked_s=1e9)[:3] == [0, 43_200, 86_400]
    assert _attempts(NO_JITTER, asked_s=0.0) == _attempts(NO_JITTER)


def test_a_service_that_was_off_for_days_does_not_give_up_what_it_has_hardly_tried() -> None:
    times = _attempts(NO_JITTER, late_s=4 * DAY_S)
    assert len(times) == 10
    assert Schedule().next_ns(FIRST, 9, FIRST + 30 * DAY_S * S, NO_JITTER) is not None
    assert Schedule().next_ns(FIRST, 10, FIRST + 30 * DAY_S * S, NO_JITTER) is None


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("120", 120.0),
        (" 7 ", 7.0),
        ("Mon, 30 Mar 2026 08:43:03 GMT", 60.0),
        ("Mon, 30 Mar 2026 08:00:00 GMT", 0.0),
        ("9" * 4000, 1e9),
        ("-5", None),
        ("1.5", None),
        ("\u0663", None),
        ("soon", None),
        ("", None),
        (None, None),
        ("Mon, 99 Mar 2026 08:43:03 GMT", None),
    ],
)
def test_retry_after(header: str | None, expected: float | None) -> None:
    assert asked_delay_s(header, FIRST) == expected
