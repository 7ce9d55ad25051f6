"""Frames are placed in one pass over their stamps just as by the usual delay of each, whatever is lost or late."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles import frame_placement
from vehicle_bus import INTERVAL_NS

from estimation.values.arrays import IntArray
from ingest.align.cycles import Placement, SyncClock, place_frames, sync_clock_of

DELAYS_NS = (50_000, 205_000, 875_000, 2_000_000, 3_560_000, 3_790_000, 3_950_000)
WIDTHS_NS = (0, 1_000, 50_000, 200_000, 249_000, 260_000, 900_000, 1_900_000)


def same(one: Placement, other: Placement) -> bool:
    counts = [(each.moved, each.late, each.ambiguous) for each in (one, other)]
    return np.array_equal(one.tick, other.tick) and counts[0] == counts[1]


def syncs(rng: np.random.Generator, kept: float, jitter_ns: int, *, broken: bool) -> SyncClock:
    """Return SYNCs of which some are lost, whose stamps jitter, and which come late or in a heap where ``broken``."""
    tick = 1000 + np.flatnonzero(rng.random(1200) < kept)
    stamps = tick * INTERVAL_NS + rng.integers(0, jitter_ns + 1, len(tick))
    if broken and len(tick):
        stamps += (rng.random(len(tick)) < 0.01) * rng.integers(-3 * INTERVAL_NS, 3 * INTERVAL_NS, len(tick))
        stamps[rng.integers(len(tick)) :] += rng.integers(5 * INTERVAL_NS)
    return sync_clock_of(np.sort(stamps), tick, INTERVAL_NS)


def frames(rng: np.random.Generator, cycles: int, delay_ns: int, width_ns: int, kept: float, late: float) -> IntArray:
    """Return stamps of frames that come with a delay of some width; some are lost, some a cycle late."""
    sent = np.arange(980, 2230, max(cycles, 1)) * INTERVAL_NS
    stamps = sent + delay_ns + rng.integers(0, width_ns + 1, len(sent)) + (rng.random(len(sent)) < late) * INTERVAL_NS
    found: IntArray = np.sort(stamps[rng.random(len(stamps)) < kept])
    return found


@settings(max_examples=300)
@given(data=st.data(), seed=st.integers(0, 2**32 - 1))
def test_frames_are_placed_as_by_numpy(data: st.DataObject, seed: int) -> None:
    def drawn(*values: Any) -> Any:  # noqa: ANN401 - one of them
        return data.draw(st.sampled_from(values))

    rng = np.random.default_rng(seed)
    clock = syncs(rng, drawn(0.0, 0.01, 0.9, 1.0, 1.0), drawn(0, 0, 1_000, 400_000), broken=drawn(0, 0, 1) == 1)
    cycles = drawn(0, 1, 1, 25, 250)
    stamps = frames(rng, cycles, drawn(*DELAYS_NS), drawn(*WIDTHS_NS), drawn(0.05, 0.6, 1.0), drawn(0.0, 0.0, 0.05))
    assert same(place_frames(clock, stamps, cycles), frame_placement.place_frames(clock, stamps, cycles))


def test_wide_delays_of_few_frames_are_counted_as_ambiguous_where_one_follows_the_last_sync() -> None:
    tick = np.arange(1000, 1004)
    clock = sync_clock_of(tick * INTERVAL_NS, tick, INTERVAL_NS)
    stamps = tick[:3] * INTERVAL_NS + [205_000, 205_000, 1_285_000]
    after_the_last = np.append(stamps, tick[-1] * INTERVAL_NS + 500_000)
    found = place_frames(clock, after_the_last, 1)
    assert found.ambiguous == len(after_the_last)
    assert same(found, frame_placement.place_frames(clock, after_the_last, 1))


def test_narrow_delays_amid_a_cycle_need_no_usual_delay_though_the_last_sync_has_no_successor() -> None:
    tick = np.arange(1000, 1500)
    clock = sync_clock_of(tick * INTERVAL_NS, tick, INTERVAL_NS)
    stamps = tick * INTERVAL_NS + 1_000_000
    found = place_frames(clock, stamps, 1)
    assert found.tick.tolist() == tick.tolist()
    assert (found.moved, found.ambiguous) == (0, 0)
