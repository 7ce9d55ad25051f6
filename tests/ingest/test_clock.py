"""Frames on the vehicle's clock: lost, late, doubled, jumping, contradicting."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from vehicle_bus import CATALOGUE, INTERVAL_NS, SECOND_NS, START_NS, Run

from estimation.errors import LogFileError
from ingest import catalogue as kinds
from ingest.align.clock import AlignedFrames, align_to_clock, check_sync_rate
from ingest.align.samples import NodeSamples, node_samples
from ingest.catalogue import SYNC_ID, TIME_ID, sync_counter, time_of_day, vehicle_time_ns
from ingest.frames import FrameBatch, concatenate, merge, sort_by_time, take
from ingest.plausibility import EARLIEST_NS, LATEST_NS

ACCELERATION_1 = 0x181
STATUS_1 = 0x281
EMERGENCY_1 = 0x081


def placed(batch: FrameBatch) -> AlignedFrames:
    return align_to_clock(CATALOGUE, merge([batch]))


def without(batch: FrameBatch, drop: np.ndarray) -> FrameBatch:
    return take(batch, ~drop)


def position_of(batch: FrameBatch, identifier: int, count: int) -> int:
    return int(np.flatnonzero(batch.arbitration_id == identifier)[count])


def samples_of(batch: FrameBatch) -> NodeSamples:
    found = node_samples(1, CATALOGUE, placed(batch).messages)
    assert found is not None
    return found[0]


def test_time_of_day_is_canopens() -> None:
    t_ns = np.array([441_763_200_000_000_000, START_NS + 999_999])  # 1984-01-01
    milliseconds, days = time_of_day(t_ns)
    assert (milliseconds[0], days[0]) == (0, 0)
    assert vehicle_time_ns(milliseconds, days).tolist() == [t_ns[0], START_NS]
    assert sync_counter([0, 239, 240]).tolist() == [1, 240, 1]


@pytest.mark.parametrize("offset_ns", [0, 37_123_456_789, -1_700_000_000 * SECOND_NS])
def test_samples_lie_on_the_vehicle_clock_whatever_the_recorder_thinks(offset_ns: int) -> None:
    run = Run(seconds=5.0, recorder_offset_ns=offset_ns)
    samples = samples_of(run.frames())
    assert np.array_equal(samples.t_ns, run.ticks * INTERVAL_NS)
    for column, values in enumerate(run.accelerations(1).values()):
        assert np.array_equal(samples.values[:, column], values)
    assert samples.valid.all()


def test_jitter_of_the_recorder_moves_no_sample() -> None:
    run = Run(seconds=5.0)
    batch = run.frames()
    rng = np.random.default_rng(0)
    jittered = sort_by_time(
        FrameBatch(
            "can0",
            batch.t_ns + rng.integers(-400_000, 400_000, len(batch)),
            batch.arbitration_id,
            batch.dlc,
            batch.data,
        )
    )
    assert not np.array_equal(jittered.arbitration_id, batch.arbitration_id), "some frames overtook their SYNC"
    samples = samples_of(jittered)
    assert np.array_equal(samples.t_ns, run.ticks * INTERVAL_NS)
    assert np.array_equal(samples.values[:, 0], run.accelerations(1)["lateral_acceleration"])


def test_a_lost_sync_costs_no_sample_but_is_counted() -> None:
    run = Run(seconds=5.0)
    batch = run.frames()
    drop = np.zeros(len(batch), dtype=bool)
    drop[[position_of(batch, SYNC_ID, k) for k in (100, 101, 700)]] = True
    result = placed(without(batch, drop))
    assert result.align_counts.syncs_missing == 3
    assert np.array_equal(result.messages[ACCELERATION_1].tick, run.ticks)


def test_frames_stamped_late_belong_to_the_sync_before_them() -> None:
    """A listener that was held up stamps a frame 17 ms late; the SYNC after it says that none was lost."""
    run = Run(seconds=5.0)
    batch = run.frames()
    t_ns = batch.t_ns.copy()
    begin = position_of(batch, SYNC_ID, 300)
    t_ns[begin + 1 : position_of(batch, SYNC_ID, 305)] = t_ns[begin] + 17_000_000
    t_ns[begin + 1 :] = np.maximum.accumulate(t_ns[begin + 1 :] + np.arange(len(t_ns) - begin - 1))
    result = placed(FrameBatch("can0", t_ns, batch.arbitration_id, batch.dlc, batch.data))
    assert np.array_equal(result.messages[ACCELERATION_1].tick, run.ticks)
    lateral = run.accelerations(1)["lateral_acceleration"]
    assert np.array_equal(
        result.messages[ACCELERATION_1].raw[:, 0] * result.messages[ACCELERATION_1].plan.signals[0].scale, lateral
    )
    assert result.align_counts.conflicting_frames == 0


def test_frames_far_from_any_sync_have_no_instant() -> None:
    run = Run(seconds=5.0)
    batch = run.frames()
    lost = np.isin(np.arange(len(batch)), np.flatnonzero(batch.arbitration_id == SYNC_ID)[200:300])
    result = placed(without(batch, lost))
    gone = len(run.ticks) - len(result.messages[ACCELERATION_1].tick)
    assert gone == 95  # all but the five cycles that the recorder's clock may bridge
    assert result.align_counts.frames_without_sync >= gone


def test_gaps_are_gaps() -> None:
    run = Run(seconds=5.0)
    batch = run.frames()
    acceleration = np.flatnonzero(batch.arbitration_id == ACCELERATION_1)
    result = placed(without(batch, np.isin(np.arange(len(batch)), acceleration[300:310])))
    assert np.array_equal(result.messages[ACCELERATION_1].tick, np.delete(run.ticks, slice(300, 310)))
    found = node_samples(1, CATALOGUE, result.messages)
    assert found is not None
    assert found[1].samples_lost == 10, "the node's sample counter shows it"


def test_two_lost_time_frames_are_bridged_and_many_are_not() -> None:
    run = Run(seconds=20.0)
    batch = run.frames()
    times = np.flatnonzero(batch.arbitration_id == TIME_ID)
    two = placed(without(batch, np.isin(np.arange(len(batch)), times[5:7])))
    assert np.array_equal(two.messages[ACCELERATION_1].tick, run.ticks)
    many = placed(without(batch, np.isin(np.arange(len(batch)), times[4:14])))
    assert many.align_counts.syncs_unplaced == 5 * SECOND_NS // INTERVAL_NS  # 11 s apart, 3 s of reach on each side
    none = placed(without(batch, batch.arbitration_id == TIME_ID))
    assert none.align_counts.time_frames == 0
    assert len(none.messages[ACCELERATION_1].tick) == 0
    assert none.times.vehicle_range(0, 1) is None


@pytest.mark.parametrize("jump_ns", [7 * SECOND_NS, -3 * SECOND_NS, 48 * INTERVAL_NS])
def test_a_jump_of_the_vehicle_clock_leaves_no_sample_at_a_guessed_time(jump_ns: int) -> None:
    before = Run(seconds=5.4)
    after = Run(
        seconds=5.0,
        start_ns=START_NS + 5_400_000_000 + jump_ns,
        recorder_offset_ns=before.recorder_offset_ns - jump_ns,
        seed=2,
    )
    result = placed(concatenate([before.frames(), after.frames()]))
    assert result.align_counts.clock_jumps == 1
    ticked = result.messages[ACCELERATION_1]
    scale = ticked.plan.signals[0].scale
    true_values: dict[int, set[float]] = {}
    for run in (before, after):
        for tick, value in zip(run.ticks.tolist(), run.accelerations(1)["lateral_acceleration"].tolist(), strict=True):
            true_values.setdefault(tick, set()).add(value)
    for tick, raw, conflict in zip(ticked.tick.tolist(), ticked.raw[:, 0].tolist(), ticked.conflict, strict=True):
        assert conflict or raw * scale in true_values[tick]
    assert result.align_counts.syncs_unplaced > 0


def test_a_counter_out_of_phase_with_the_clock_is_not_believed() -> None:
    run = Run(seconds=3.0, changes={(kinds.SYNC, 0): {"counter": sync_counter(Run(seconds=3.0).ticks + 60)}})
    result = placed(run.frames())
    assert result.align_counts.syncs_unplaced == len(run.ticks)


def test_the_same_frame_again_is_dropped_and_another_at_its_instant_is_a_conflict() -> None:
    run = Run(seconds=3.0)
    batch = run.frames()
    at = [position_of(batch, ACCELERATION_1, k) for k in (10, 20)]
    again = take(batch, np.array(at))
    other = again.data.copy()
    other[1, 0] ^= 0xFF
    late = FrameBatch("can0", again.t_ns + 50_000, again.arbitration_id, again.dlc, other)
    result = placed(concatenate([batch, late]))
    assert (result.align_counts.duplicate_frames, result.align_counts.conflicting_frames) == (1, 1)
    samples = samples_of(concatenate([batch, late]))
    assert np.flatnonzero(~samples.valid.all(axis=1)).tolist() == [20]
    assert np.isnan(samples.values[20]).all()


def test_clipping_and_not_available_are_marked_per_sample() -> None:
    run = Run(seconds=3.0)
    values = run.accelerations(1)
    values["yaw_acceleration"][100:103] = 1e6
    values["roll_acceleration"][200] = np.nan
    marked = Run(seconds=3.0, changes={(kinds.ACCELERATION, 1): values})
    samples = samples_of(marked.frames())
    assert np.flatnonzero(samples.clipped).tolist() == [100, 101, 102]
    assert np.flatnonzero(samples.invalid).tolist() == [200]
    assert np.flatnonzero(~samples.valid[:, 1]).tolist() == [100, 101, 102]
    assert np.flatnonzero(~samples.valid[:, 2]).tolist() == [200]
    assert samples.valid[:, 0].all()


def test_the_clipping_bit_marks_the_second_that_it_belongs_to() -> None:
    ticks = Run(seconds=5.0).ticks
    bit = (ticks * INTERVAL_NS == START_NS + 2 * SECOND_NS).astype(float)
    samples = samples_of(Run(seconds=5.0, changes={(kinds.STATUS, 1): {"roll_clipped": bit}}).frames())
    assert samples.clipped_seconds is not None
    marked = samples.t_ns[samples.clipped_seconds]
    assert (marked[0], marked[-1]) == (START_NS + SECOND_NS + INTERVAL_NS, START_NS + 2 * SECOND_NS)
    assert len(marked) == 250
    assert samples.valid.all(), "the sample itself may be good: the gate decides"


def test_more_frames_than_the_node_says_it_sent_are_not_believed() -> None:
    counter = 1000 + np.arange(1250)
    counter[counter >= 1500] -= 7  # 243 samples in the second that had 250
    run = Run(seconds=5.0, changes={(kinds.STATUS, 1): {"sample_counter": counter}})
    found = node_samples(1, CATALOGUE, placed(run.frames()).messages)
    assert found is not None
    assert found[1].counter_mismatches == 1
    wrong = found[0].t_ns[~found[0].valid.all(axis=1)]
    assert (wrong[0], wrong[-1]) == (START_NS + SECOND_NS + INTERVAL_NS, START_NS + 2 * SECOND_NS)


def test_a_restarted_node_is_counted_and_its_samples_are_kept() -> None:
    counter = np.where(np.arange(1250) < 600, 5000 + np.arange(1250), np.arange(1250) - 600)
    run = Run(seconds=5.0, changes={(kinds.STATUS, 1): {"sample_counter": counter}})
    found = node_samples(1, CATALOGUE, placed(run.frames()).messages)
    assert found is not None
    assert (found[1].counter_resets, found[1].samples_lost) == (1, 0)
    assert found[0].valid.all()


def test_a_recording_of_another_rate_is_refused() -> None:
    batch = Run(seconds=2.0).frames()
    check_sync_rate(batch, INTERVAL_NS)
    with pytest.raises(LogFileError, match=r"every 4\.000 ms, the catalogue says every 1\.000 ms"):
        check_sync_rate(batch, 1_000_000)


@pytest.mark.parametrize(("seconds", "refused"), [(1.0, False), (1.02, True)])
def test_what_a_receiver_took_out_of_its_socket_at_once_shows_no_rate(seconds: float, *, refused: bool) -> None:
    """A piece of a live bus can be all of that: its stamps are when it was read."""
    batch = Run(seconds=seconds).frames()
    at_once = replace(batch, t_ns=START_NS + np.arange(len(batch)) * 50_000)
    if refused:
        with pytest.raises(LogFileError, match="SYNC comes every"):
            check_sync_rate(at_once, INTERVAL_NS)
    else:
        check_sync_rate(at_once, INTERVAL_NS)


def test_a_recording_that_was_read_in_bursts_has_the_rate_of_its_bus() -> None:
    """A receiver on a busy machine stamps what came meanwhile when it is its turn."""
    batch = Run(seconds=5.0).frames()
    since = batch.t_ns - batch.t_ns[0]
    burst = since // 300_000_000
    in_burst = np.arange(len(batch)) - np.searchsorted(burst, burst)
    check_sync_rate(replace(batch, t_ns=START_NS + burst * 300_000_000 + in_burst * 50_000), INTERVAL_NS)


def with_time(batch: FrameBatch, numbers: list[int], vehicle_ns: int, step_ns: int = SECOND_NS) -> FrameBatch:
    """Return the batch with some of its TIME frames showing another time, a step later each."""
    data = batch.data.copy()
    for number, frame in enumerate(numbers):
        milliseconds, days = time_of_day(vehicle_ns + number * step_ns)
        at = position_of(batch, TIME_ID, frame)
        data[at, :6] = np.frombuffer(
            int(milliseconds).to_bytes(4, "little") + int(days).to_bytes(2, "little"), np.uint8
        )
    return replace(batch, data=data)


YEAR_NS = 365 * 86_400 * SECOND_NS
DAY_1984_NS = 5113 * 86_400 * SECOND_NS


@pytest.mark.parametrize(("numbers", "shown_ns"), [([4], START_NS + YEAR_NS), ([4, 5], START_NS - YEAR_NS)])
def test_a_few_odd_time_frames_among_good_ones_cost_nothing_but_a_count(numbers: list[int], shown_ns: int) -> None:
    batch = Run(seconds=12.0).frames()
    good, odd = placed(batch), placed(with_time(batch, numbers, shown_ns))
    assert odd.align_counts.time_frames_implausible == len(numbers)
    assert (odd.align_counts.syncs_unplaced, odd.align_counts.clock_jumps) == (0, 0)
    assert odd.times.vehicle_range(0, 1) == good.times.vehicle_range(0, 1)
    for identifier, found in good.messages.items():
        assert np.array_equal(found.tick, odd.messages[identifier].tick)


def test_three_in_a_row_are_a_clock_that_was_set() -> None:
    batch = Run(seconds=12.0).frames()
    found = placed(with_time(batch, [4, 5, 6], START_NS + YEAR_NS)).align_counts
    assert (found.time_frames_implausible, found.clock_jumps) == (0, 2)


@pytest.mark.parametrize(
    ("shown_ns", "left_out"),
    [
        (DAY_1984_NS, 12),
        (EARLIEST_NS - 12 * SECOND_NS, 12),
        (EARLIEST_NS, 0),
        (LATEST_NS - 12 * SECOND_NS, 0),
        (LATEST_NS, 12),
    ],
)
def test_a_clock_that_was_never_set_places_nothing(shown_ns: int, left_out: int) -> None:
    assert (EARLIEST_NS, LATEST_NS) == (946_684_800 * SECOND_NS, 4_102_444_800 * SECOND_NS)  # 2000 and 2100
    batch = Run(seconds=12.0).frames()
    found = placed(with_time(batch, list(range(12)), shown_ns))
    assert (found.align_counts.time_frames_implausible, len(found.times.t_ns)) == (left_out, 12 - left_out)


def test_an_odd_time_frame_at_the_end_does_not_stretch_a_recording() -> None:
    batch = Run(seconds=12.0).frames()
    good, odd = placed(batch), placed(with_time(batch, [11], START_NS + YEAR_NS))
    ends = int(batch.t_ns[0]), int(batch.t_ns[-1])
    assert odd.times.vehicle_range(*ends) == good.times.vehicle_range(*ends)
