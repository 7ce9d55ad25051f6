"""Small inputs that run the compiled kernels between frames and stored windows; see ``kernel_runs``."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from estimation.motion.hunting import find_hunting
from estimation.values.arrays import FloatArray
from ingest.align.cycles import by_stamps, place_frames, sync_clock_of
from ingest.align.samples import between_frames, gaps_of, good_samples, gridded, on_section, range_of

INTERVAL_NS = 4_000_000


def _hunting() -> Iterator[FloatArray]:
    interval_s = 0.02
    at = interval_s * np.arange(500)
    omega, speed = 2.0 * np.pi * 2.0, np.full(len(at), 20.0)
    lateral = -(omega**2) * 6e-3 * np.cos(omega * at)
    yaw = omega**3 * 6e-3 / 20.0 * np.sin(omega * at)
    lateral[250:] = 0.0
    found = find_hunting(lateral, yaw, speed, interval_s)
    yield np.array([found.share, found.frequency_hz, found.amplitude])


def _cycles() -> Iterator[FloatArray]:
    number = np.array([10, 11, 12, 15, 16, 17, 18])
    stamps = number * INTERVAL_NS
    stamps[-1] += 3 * INTERVAL_NS
    clock = sync_clock_of(stamps, number, INTERVAL_NS)
    t_ns = np.sort(np.concatenate([np.arange(9, 25) * INTERVAL_NS + 100_000, stamps + 1_000_000]))
    tick, found = by_stamps(clock.t_ns, clock.tick, clock.sent_ns, INTERVAL_NS, t_ns)
    yield tick.astype(float)
    yield np.array([float(value) for value in found])
    yield place_frames(clock, np.append(t_ns, t_ns[-1] + 10**10), 1).tick.astype(float)


def _window_samples() -> Iterator[FloatArray]:
    slot = np.array([0, 1, 2, 4, 5, 6, 9])
    valid = np.ones((7, 4), np.bool_)
    valid[1, 2] = False
    clipped = slot == 5
    speed = np.where(np.arange(10) == 9, np.nan, 20.0)
    good, count = good_samples(slot, valid, clipped, speed, 1)
    yield np.append(good.astype(float), count)
    section = np.arange(10) // 5
    yield np.array(range_of(section, slot, good), float)
    distance = on_section(np.arange(10.0), np.ones(10), section, 0, 1.5)
    yield distance
    yield gridded(np.arange(28.0).reshape(7, 4), slot, good, 10, 2).ravel()
    yield np.array(gaps_of(np.isfinite(distance)), float)
    found, slope, before = between_frames(10, np.array([2, 5]), np.array([1.0, 4.0]), np.array([1.0, np.nan]))
    yield from (found, slope, before.astype(float))


RUNS: tuple[Callable[[], Iterator[FloatArray]], ...] = (_hunting, _cycles, _window_samples)
