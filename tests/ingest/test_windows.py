"""Windows: what a wheelset gets of a run whose every value is known."""

from __future__ import annotations

import numpy as np
import pytest
from vehicle_bus import CATALOGUE, INTERVAL_NS, OFFSETS_M, SECOND_NS, SECTION, START_NS, VEHICLE, Run

from estimation.errors import ParameterError
from estimation.motion.checks import gate
from estimation.motion.integration import Gates
from estimation.values.reasons import ReasonCode, code_of
from estimation.values.registry import Mounting, VehicleRecord
from estimation.values.windows import Window
from ingest import catalogue as kinds
from ingest.align.clock import align_to_clock
from ingest.align.windows import (
    CLIPPING_GUARD_S,
    MountedWindow,
    RegistryLookup,
    WindowCounts,
    vehicle_samples,
    windows_of,
)
from ingest.frames import merge, take

LENGTH_NS = 10 * SECOND_NS
COUNT = LENGTH_NS // INTERVAL_NS
RECORD = VehicleRecord(VEHICLE, "north", "multiple unit", 2, 40.0, OFFSETS_M)


MOUNTED = tuple(Mounting(f"WS-{axle}", VEHICLE, axle, 0, None, 0.0, 0.0) for axle in (1, 2))
LOOKUP = RegistryLookup(RECORD, MOUNTED, {SECTION: "KM12"})


def windows(
    run: Run, lookup: RegistryLookup = LOOKUP, drop: np.ndarray | None = None
) -> tuple[list[Window], WindowCounts]:
    batch = run.frames()
    if drop is not None:
        batch = take(batch, ~np.isin(batch.arbitration_id, drop))
    samples, _ = vehicle_samples(VEHICLE, CATALOGUE, align_to_clock(CATALOGUE, merge([batch])).messages)
    starts = range(run.start_ns // LENGTH_NS * LENGTH_NS, int(run.ticks[-1]) * INTERVAL_NS + 1, LENGTH_NS)
    found, counts = [], WindowCounts()
    for outcome in windows_of(samples, starts, LENGTH_NS, lookup):
        if isinstance(outcome, MountedWindow):
            found.append(outcome.window)
        else:
            counts += outcome
    return found, counts


def test_windows_hold_what_was_sent_at_the_place_of_the_wheelset() -> None:
    run = Run(seconds=25.0)  # begins 3 s into a window: 7 s, 10 s, 8 s
    found, counts = windows(run)
    assert counts == WindowCounts()
    assert [(w.wheelset, (w.start_ns - START_NS) // SECOND_NS) for w in found] == [
        (f"WS-{axle}", start) for start in (-3, 7, 17) for axle in (1, 2)
    ]
    for window in found:
        first = (window.start_ns // INTERVAL_NS) - int(run.ticks[0])
        inside = np.arange(first, first + COUNT)
        there = (inside >= 0) & (inside < len(run.ticks) - 24)  # after the last vehicle frame nothing is extrapolated
        assert np.array_equal(window.valid, there)
        for name, sent in run.accelerations(window.axle).items():
            assert np.array_equal(getattr(window, name)[there], sent[inside[there]])
            assert np.isnan(getattr(window, name)[~there]).all()
        expected = run.distance + run.metres()[inside[there]] - OFFSETS_M[window.axle - 1]
        assert np.abs(window.distance[there] - expected).max() < 1e-3
        assert np.abs(window.speed[there] - run.speed).max() < 1e-3
        assert window.odometer_m == pytest.approx(run.odometer + run.speed * first * INTERVAL_NS * 1e-9, abs=0.51)
        assert (window.track_section, window.quality.position_quality > 0.8) == ("KM12", True)
        assert window.quality.coverage == pytest.approx(there.mean())


def test_quality_counts_gaps_clipping_and_invalid_values() -> None:
    run = Run(seconds=17.0)
    values = run.accelerations(1)
    values["lateral_acceleration"][1750 + 100 : 1750 + 150] = np.nan  # in the window that begins 7 s after the start
    values["yaw_acceleration"][1750 + 500 : 1750 + 525] = 1e6
    found, _ = windows(Run(seconds=20.0, changes={(kinds.ACCELERATION, 1): padded(values, 5000)}))
    quality = next(w for w in found if w.axle == 1 and w.start_ns == START_NS + 7 * SECOND_NS).quality
    assert (quality.gaps, quality.longest_gap_s) == (2, 0.2)
    assert (quality.invalid, quality.clipped) == (50 / 2500, 25 / 2500)
    guarded = 2 * round(CLIPPING_GUARD_S * SECOND_NS / INTERVAL_NS)
    assert quality.coverage == 1.0 - (75 + guarded) / 2500
    assert (quality.speed_min_m_s, quality.speed_max_m_s) == (20.0, 20.0)
    assert not quality.sensor_fault


def test_a_second_with_the_clipping_bit_is_left_out() -> None:
    bit = (Run(seconds=25.0).ticks * INTERVAL_NS == START_NS + 12 * SECOND_NS).astype(float)
    found, _ = windows(Run(seconds=25.0, changes={(kinds.STATUS, 1): {"lateral_clipped": bit}}))
    (hit,) = (w for w in found if w.axle == 1 and w.quality.clipped > 0)
    assert hit.quality.clipped == pytest.approx(0.1, abs=0.001)
    assert hit.quality.coverage == pytest.approx(0.9 - 2 * CLIPPING_GUARD_S / 10.0, abs=0.001)
    assert np.isnan(hit.lateral_acceleration[~hit.valid]).all()


def test_a_wheelset_that_hunts_is_seen_though_no_sample_of_it_is_left() -> None:
    """Flange contact drives both sensors to the ends of their ranges, several times a second."""
    values = Run(seconds=25.0).accelerations(1)
    at = np.arange(len(values["yaw_acceleration"])) * INTERVAL_NS * 1e-9
    omega = 2.0 * np.pi * 4.0  # 5 m at 20 m/s
    values["lateral_acceleration"] = -300.0 * np.cos(omega * at)
    values["yaw_acceleration"] = 300.0 * omega / 20.0 * np.sin(omega * at)
    found, _ = windows(Run(seconds=25.0, changes={(kinds.ACCELERATION, 1): values}))
    hunting = next(w for w in found if w.axle == 1 and w.start_ns == START_NS + 7 * SECOND_NS)
    assert hunting.quality.clipped > 0.5
    assert hunting.quality.coverage == 0.0
    assert hunting.quality.hunting.share == 1.0
    assert hunting.quality.hunting.frequency_hz == pytest.approx(4.0, rel=0.02)
    assert code_of(gate(hunting.quality, "KM12", Gates())) is ReasonCode.HUNTING
    assert all(w.quality.hunting.share == 0.0 for w in found if w.axle == 2)


def padded(values: dict[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
    return {name: np.concatenate([value, np.zeros(count - len(value))]) for name, value in values.items()}


def test_a_dead_sensor_gives_a_window_that_says_so_and_a_silent_one_none() -> None:
    dead = dict.fromkeys(Run().accelerations(1), np.nan)
    changes = {(kinds.ACCELERATION, 1): dead, (kinds.STATUS, 1): {"self_test_failed": 1.0}}
    found, counts = windows(Run(seconds=25.0, changes=changes), drop=np.array([0x182]))
    assert {window.axle for window in found} == {1}
    assert all(w.quality.sensor_fault and w.quality.coverage == 0.0 and w.quality.invalid == 1.0 for w in found)
    assert counts.windows == 0


def test_a_standing_vehicle_makes_no_windows() -> None:
    found, counts = windows(Run(seconds=25.0, speed=0.0))
    assert (found, counts.windows_standing) == ([], 6)


def test_without_speed_nothing_is_valid_and_nothing_is_made() -> None:
    found, _ = windows(Run(seconds=25.0), drop=np.array([0x190]))
    assert found == []


def test_without_position_accelerations_stay_and_the_place_is_unknown() -> None:
    found, _ = windows(Run(seconds=25.0), drop=np.array([0x390]))
    assert {w.track_section for w in found} == {None}
    assert all(np.isnan(w.distance).all() and w.valid.any() and w.quality.position_quality == 0.0 for w in found)


def test_a_section_that_the_registry_does_not_know_is_no_section() -> None:
    found, _ = windows(Run(seconds=25.0), RegistryLookup(RECORD, MOUNTED, {}))
    assert {w.track_section for w in found} == {None}


def test_a_window_belongs_to_one_section() -> None:
    ticks = Run(seconds=20.0).ticks
    section = np.where(np.arange(len(ticks)) < 2750, SECTION, SECTION + 1)  # 4 s into the window at 7 s
    position = {"track_section": section, "distance": np.where(section == SECTION, 100.0, 0.0) + np.arange(5000) * 0.08}
    lookup = RegistryLookup(RECORD, MOUNTED, {SECTION: "KM12", SECTION + 1: "KM13"})
    found, _ = windows(Run(seconds=20.0, changes={(kinds.POSITION, 16): position}), lookup)
    window = next(w for w in found if w.axle == 1 and w.start_ns == START_NS + 7 * SECOND_NS)
    assert window.track_section == "KM13"
    assert not window.valid[:1000].any()
    assert window.valid[1100:].all()
    assert np.isnan(window.distance[:1000]).all()


def test_running_backwards_the_wheelset_is_ahead_of_the_reference() -> None:
    ticks = Run(seconds=20.0).ticks
    falling = {"distance": 5000.0 - 0.08 * np.arange(len(ticks))}
    found, _ = windows(Run(seconds=20.0, changes={(kinds.POSITION, 16): falling}))
    window = next(w for w in found if w.axle == 2 and w.start_ns == START_NS + 7 * SECOND_NS)
    expected = 5000.0 - 0.08 * (1750 + np.arange(COUNT)) + OFFSETS_M[1]
    assert np.abs(window.distance - expected).max() < 1e-3


def test_wheelsets_are_looked_up_by_time() -> None:
    exchange = START_NS + 12 * SECOND_NS

    old = Mounting("old", VEHICLE, 2, 0, exchange, 0.0, 0.0)
    new = Mounting("new", VEHICLE, 2, exchange, None, 0.0, 0.0)
    found, counts = windows(Run(seconds=25.0), RegistryLookup(RECORD, (old, new), {SECTION: "KM12"}))
    assert [w.wheelset for w in found] == ["old", "new"]
    assert counts.windows_unmounted == 4  # axle 1 three times, and the window in which the exchange falls


def test_edges_below_a_fifth_of_a_window_are_counted_only() -> None:
    found, counts = windows(Run(seconds=8.0))  # 7 s and 1 s
    assert len(found) == 2
    assert counts.windows_too_short == 2


def test_the_window_length_is_a_whole_number_of_samples() -> None:
    samples, _ = vehicle_samples(VEHICLE, CATALOGUE, {})
    with pytest.raises(ParameterError, match="whole number of sampling intervals"):
        list(windows_of(samples, [0], LENGTH_NS + 1, LOOKUP))
