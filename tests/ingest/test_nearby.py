"""Windows of a span need what is near it; where the vehicle's clock cannot be believed, whole recordings count."""

from __future__ import annotations

import numpy as np
import pytest
from vehicle_bus import CATALOGUE, INTERVAL_NS, SECOND_NS, START_NS, Run

from ingest.align.clock import CONTEXT_NS, align_to_clock, frames_near, values_near
from ingest.catalogue import TIME_ID
from ingest.frames import FrameBatch, concatenate, merge, sort_by_time, take

SPAN = (START_NS + 60 * SECOND_NS, START_NS + 70 * SECOND_NS)


def halves(batch: FrameBatch) -> list[FrameBatch]:
    middle = len(batch) // 2
    return [take(batch, slice(None, middle)), take(batch, slice(middle, None))]


@pytest.fixture(scope="module")
def steady() -> FrameBatch:
    return merge([Run(seconds=120.0).frames()])


def test_frames_near_a_span_give_its_samples_as_all_frames_do(steady: FrameBatch) -> None:
    parts = halves(steady)
    alone = [align_to_clock(CATALOGUE, part) for part in parts]
    near = frames_near(parts, alone, SPAN)
    assert sum(map(len, near)) == pytest.approx(len(steady) * (10.0 + 2.0 * CONTEXT_NS / SECOND_NS) / 120.0, rel=0.01)
    few = align_to_clock(CATALOGUE, merge(near)).messages
    whole = align_to_clock(CATALOGUE, steady).messages
    ends = np.array(SPAN) // INTERVAL_NS
    for arbitration_id, values in whole.items():
        found = few[arbitration_id]
        ours, theirs = (slice(*np.searchsorted(one.tick, ends).tolist()) for one in (found, values))
        assert found.tick[ours].tolist() == values.tick[theirs].tolist()
        assert np.array_equal(found.raw[ours], values.raw[theirs])
    assert set(values_near(whole, SPAN, INTERVAL_NS)) == set(whole)


def test_values_near_a_span_are_within_the_context(steady: FrameBatch) -> None:
    whole = align_to_clock(CATALOGUE, steady).messages
    first, behind = (SPAN[0] - CONTEXT_NS) // INTERVAL_NS, (SPAN[1] + CONTEXT_NS) // INTERVAL_NS
    for arbitration_id, values in values_near(whole, SPAN, INTERVAL_NS).items():
        tick = whole[arbitration_id].tick
        assert values.tick.tolist() == tick[(tick >= first) & (tick < behind)].tolist()
    assert not values_near(whole, (0, SECOND_NS), INTERVAL_NS)


def test_all_frames_count_where_the_clock_jumps_or_a_time_is_odd_or_none_is_sent(steady: FrameBatch) -> None:
    times = np.flatnonzero(steady.arbitration_id == TIME_ID)
    odd = steady.data.copy()
    odd[times[3], 2] ^= 0x40  # an hour off, alone among others
    run = Run(seconds=5.0, start_ns=START_NS + 125 * SECOND_NS, recorder_offset_ns=-(10**9))
    for batch in (
        sort_by_time(concatenate([steady, run.frames()])),
        FrameBatch("can0", steady.t_ns, steady.arbitration_id, steady.dlc, odd),
        take(steady, steady.arbitration_id != TIME_ID),
    ):
        parts = halves(batch)
        near = frames_near(parts, [align_to_clock(CATALOGUE, part) for part in parts], SPAN)
        assert sum(map(len, near)) == len(batch)
