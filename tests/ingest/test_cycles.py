"""Which SYNC cycle a frame belongs to: at every delay, with jitter, from log files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from log_files import write_recording
from vehicle_bus import CATALOGUE, INTERVAL_NS, SECOND_NS, START_NS

from ingest import catalogue as kinds
from ingest.align.clock import AlignedFrames, align_to_clock
from ingest.align.cycles import UNPLACED, place_frames, sync_clock_of
from ingest.catalogue import SYNC_ID, sync_counter, time_of_day
from ingest.codec import encode
from ingest.frames import FrameBatch, concatenate, merge, sort_by_time, take
from ingest.logs import read_log

NODES = 8
FRAME_NS = 115_000  # 8 data bytes at 1 Mbit/s
TICKS = START_NS // INTERVAL_NS + np.arange(10 * SECOND_NS // INTERVAL_NS)
ACCELERATIONS = [0x180 + node for node in range(1, NODES + 1)]
POSITION = 0x390
DELAYS_MS = (0.05, 0.1, 0.5, 1.0, 2.0, 2.9, 3.1, 3.5, 3.7, 3.9, 3.95)


def bus(delay_ns: int, jitter_ns: float) -> FrameBatch:
    """Return a bus of 8 nodes and the vehicle node on which every lateral acceleration and distance is its tick.

    Node 1 and the position come ``delay_ns`` after SYNC, the other nodes a frame time after each other.
    """
    rng = np.random.default_rng(int(delay_ns))
    milliseconds, days = time_of_day(TICKS * INTERVAL_NS)
    said = [
        (CATALOGUE.find(kinds.SYNC), 0, {"counter": sync_counter(TICKS)}),
        (CATALOGUE.find(kinds.TIME), FRAME_NS, {"milliseconds": milliseconds, "days": days}),
        (CATALOGUE.find(kinds.POSITION, 16), delay_ns, {"track_section": 1, "distance": 1e-3 * (TICKS - TICKS[0])}),
    ]
    for node in range(1, NODES + 1):
        plan = CATALOGUE.find(kinds.ACCELERATION, node)
        delay = delay_ns if node == 1 else 50_000 + (delay_ns + node * FRAME_NS) % (INTERVAL_NS - 100_000)
        said.append((plan, delay, {"lateral_acceleration": plan.signal("lateral_acceleration").scale * number()}))
    batches = []
    for plan, delay, values in said:
        at = np.flatnonzero(TICKS * INTERVAL_NS % plan.cycle_ns == 0)
        stamps = TICKS[at] * INTERVAL_NS + delay + np.rint(rng.uniform(-jitter_ns, jitter_ns, len(at))).astype(int)
        given = {name: np.broadcast_to(value, TICKS.shape)[at] for name, value in values.items()}
        batches.append(encode(plan, stamps, given))
    return sort_by_time(concatenate(batches))


def number() -> np.ndarray:
    return (TICKS - TICKS[0]).astype(float)


def misplaced(result: AlignedFrames, arbitration_id: int, name: str) -> int:
    """Return how many frames are not at the tick that they carry, or at none."""
    values = result.messages[arbitration_id]
    wrong = np.count_nonzero(values.column(name) != values.tick - TICKS[0]) + np.count_nonzero(values.conflict)
    return int(wrong) + result.align_counts.frames_without_sync


@pytest.mark.parametrize("delay_ms", DELAYS_MS)
def test_frames_at_every_delay_belong_to_the_cycle_that_they_were_produced_in(delay_ms: float) -> None:
    batch = bus(int(1e6 * delay_ms), 200_000.0)
    result = align_to_clock(CATALOGUE, merge([batch]))
    for arbitration_id in ACCELERATIONS:
        assert len(result.messages[arbitration_id].tick) == len(TICKS)
        assert misplaced(result, arbitration_id, "lateral_acceleration") == 0
    if 0.1 <= delay_ms <= 3.9:
        assert misplaced(result, POSITION, "distance") == 0


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".log"])
def test_frames_in_log_files_keep_their_cycle(tmp_path: Path, suffix: str) -> None:
    batch = bus(3_700_000, 200_000.0)
    path = tmp_path / f"run{suffix}"
    write_recording(path, take(batch, slice(0, 8000)))
    result = align_to_clock(CATALOGUE, merge([read_log(path)]))
    assert sum(misplaced(result, arbitration_id, "lateral_acceleration") for arbitration_id in ACCELERATIONS) == 0
    assert misplaced(result, POSITION, "distance") == 0
    assert result.align_counts.frames_moved > 0


def test_late_frames_around_a_lost_sync_keep_their_cycle() -> None:
    batch = bus(3_700_000, 100_000.0)
    lost = np.flatnonzero(batch.arbitration_id == SYNC_ID)[[300, 301, 900]]
    result = align_to_clock(CATALOGUE, merge([take(batch, np.setdiff1d(np.arange(len(batch)), lost))]))
    assert result.align_counts.syncs_missing == 3
    assert misplaced(result, ACCELERATIONS[0], "lateral_acceleration") == 0


def test_a_frame_that_a_full_bus_sends_after_the_next_sync_is_known_by_its_rhythm() -> None:
    """At 500 kbit/s the status frames of 8 nodes hold back the position of every tenth time."""
    batch = bus(2_500_000, 50_000.0)
    second = (batch.arbitration_id == POSITION) & (np.abs(batch.t_ns % SECOND_NS - 2_500_000) < 1_000_000)
    late = sort_by_time(replace(batch, t_ns=batch.t_ns + np.where(second, 4_300_000, 0)))
    result = align_to_clock(CATALOGUE, merge([late]))
    assert result.align_counts.frames_late == np.count_nonzero(second) == 10
    assert misplaced(result, POSITION, "distance") == 0


def test_where_the_usual_delay_is_beside_a_sync_frames_are_counted_as_ambiguous() -> None:
    ticks = np.arange(5000)
    clock = sync_clock_of(ticks * INTERVAL_NS, ticks, INTERVAL_NS)
    jitter = np.rint(np.random.default_rng(1).normal(0.0, 2e5, 200)).astype(int)
    beside = place_frames(clock, np.sort(ticks[25::25] * INTERVAL_NS + jitter[:199]), 25)
    assert beside.ambiguous > 100
    amid = place_frames(clock, np.sort(ticks[::25] * INTERVAL_NS + 2_000_000 + jitter), 25)
    assert (amid.ambiguous, amid.moved) == (0, 0)


def test_frames_spread_over_the_whole_cycle_go_by_their_stamps() -> None:
    ticks = np.arange(5000)
    clock = sync_clock_of(ticks * INTERVAL_NS, ticks, INTERVAL_NS)
    t_ns = ticks * INTERVAL_NS + np.random.default_rng(2).integers(0, INTERVAL_NS, 5000)
    placement = place_frames(clock, t_ns, 1)
    assert np.array_equal(placement.tick, ticks)
    assert 300 < placement.ambiguous < 700, "a tenth are within a twentieth of a cycle of a SYNC"


def test_frames_before_the_first_sync_are_placed_only_where_they_belong_to_it() -> None:
    ticks = 1000 + np.arange(1000)
    clock = sync_clock_of(ticks * INTERVAL_NS, ticks, INTERVAL_NS)
    own = ticks * INTERVAL_NS + 50_000
    own[0] -= 100_000
    assert place_frames(clock, own, 1).tick[0] == 1000
    late = np.concatenate([[ticks[0] * INTERVAL_NS - 100_000], ticks * INTERVAL_NS + 3_900_000])
    assert place_frames(clock, late, 1).tick[:2].tolist() == [UNPLACED, 1000]


def test_the_cycle_of_a_frame_does_not_depend_on_the_cut_of_the_recording() -> None:
    batch = bus(3_900_000, 200_000.0)
    whole = align_to_clock(CATALOGUE, batch).messages[ACCELERATIONS[0]]
    part = align_to_clock(CATALOGUE, take(batch, batch.t_ns < START_NS + 8 * SECOND_NS)).messages[ACCELERATIONS[0]]
    inside = part.tick < TICKS[5 * SECOND_NS // INTERVAL_NS]
    assert np.array_equal(part.tick[inside], whole.tick[: np.count_nonzero(inside)])
