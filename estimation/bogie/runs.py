"""The windows of both axles of a bogie in; its uninterrupted runs over a known alignment out."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import BogieRun
from estimation.motion.checks import direction, moving_samples, usable_samples
from estimation.motion.integration import IntegratedSegment, WindowParameters, integrate, standard_displacement
from estimation.motion.window_motion import alignment_at
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.memory import MEMORY
from estimation.values.track import Correction, TrackAlignment, TrackLayout
from estimation.values.windows import Window


@dataclass(frozen=True, slots=True)
class AxleWindow:
    """The window of one axle of a bogie, as it travels, with the yaw of the frame in it."""

    window: Window
    correction: Correction | None = None

    @property
    def distance(self) -> FloatArray:
        """Where the axle is along the section (n,), m."""
        distance = self.window.distance
        return distance if self.correction is None else self.correction.at(distance)


def bogie_runs(
    leading: AxleWindow,
    trailing: AxleWindow,
    track: TrackAlignment,
    parameters: WindowParameters,
    layout: TrackLayout | None = None,
) -> Iterator[BogieRun]:
    """Yield the runs of both windows, of one time, in which all samples can be used."""
    axles = leading, trailing
    cutoff = min(BOGIE.longest_wave, track.cutoff_wavelength)
    facing = direction(leading.window) * (-1 if leading.window.backwards else 1)
    track = probable(track)
    own = [facing * alignment_at(axle.distance, track, cutoff) for axle in axles]
    usable: BoolArray = np.ones(len(leading.window.valid), dtype=np.bool_)
    for axle, d in zip(axles, own, strict=True):
        window = replace(axle.window, distance=axle.distance)
        usable &= usable_samples(window, np.isfinite(d), layout, parameters.signals).samples
        usable &= moving_samples(axle.window, parameters.signals)
    both = [integrate(axle.window, usable, parameters.signals).segments for axle in axles]
    for pair in zip(*both, strict=True):
        ahead = np.stack(
            [_with_way_there(axle, segment, track, facing, cutoff) for axle, segment in zip(axles, pair, strict=True)]
        )
        if np.isfinite(ahead).all():
            yield _run(*pair, ahead, parameters)


def _with_way_there(
    axle: AxleWindow, segment: IntegratedSegment, track: TrackAlignment, facing: int, cutoff: float
) -> FloatArray:
    """Return d (k,), m, under an axle over its run and a way before it at the speed of its begin."""
    at = axle.distance[segment.part]
    dt, speed = axle.window.sample_interval_s, float(segment.speed[0])
    step = np.sign(at[-1] - at[0]) * speed * dt
    before = at[0] + step * np.arange(-round(BOGIE.warm_up_m / (speed * dt)), 0)
    inside = np.clip(before, track.s[0], track.s[-1])  # a bogie that comes from off the section comes along its end
    d = facing * alignment_at(np.concatenate([inside, at]), track, cutoff)
    known = np.isfinite(d)
    known[len(before) :] = True
    return np.asarray(np.where(known, d, d[known & np.isfinite(d)][0] if (known & np.isfinite(d)).any() else np.nan))


def _run(
    leading: IntegratedSegment, trailing: IntegratedSegment, ahead: FloatArray, parameters: WindowParameters
) -> BogieRun:
    pair, radius = (leading, trailing), parameters.vehicle.nominal_radius
    n = len(leading.run)
    kinds = [np.stack([item.displacements, item.rates, item.accelerations]) for item in pair]
    lateral, yaw, roll, above = (np.stack([kind[:, row] for kind in kinds], axis=1) for row in range(4))
    assert leading.frame_yaw is not None
    interval = float((leading.run[-1]) / np.sum(0.5 * (leading.speed[1:] + leading.speed[:-1])))
    track = ahead[:, ahead.shape[1] - n :]
    relative = np.stack(
        [
            standard_displacement(lateral[0, axle] - track[axle], roll[0, axle], radius, level=item.level)
            for axle, item in enumerate(pair)
        ]
    )
    return BogieRun(
        interval_s=interval,
        speed=leading.speed,
        lateral=lateral,
        yaw=yaw,
        roll=roll[:2],
        frame_lateral=above[:2].mean(axis=1),
        frame_yaw=leading.frame_yaw[::-1],
        relative=relative,
        ahead=ahead,
    )


@lru_cache(maxsize=MEMORY.deconvolved_tracks)
def probable(track: TrackAlignment) -> TrackAlignment:
    """Return a recorded alignment as it most probably is: each wave times its share that is not noise.

    What is left of its error has then nothing in common with it, and so with what is simulated over it: the curves are
    not flattened by it.
    """
    known = np.isfinite(track.alignment)
    if not known.all() or not BOGIE.wiener:
        return track
    step, n = float(track.s[1] - track.s[0]), len(track.s)
    std = float(np.median(track.alignment_std))
    mean = track.alignment.mean()
    padded = np.concatenate([track.alignment - mean, (track.alignment - mean)[::-1]])
    spectrum = np.fft.rfft(padded)
    wavenumber = np.fft.rfftfreq(2 * n, step)
    power = np.abs(spectrum) ** 2 * step / (2 * n)  # m3, one-sided over positive and negative wavenumbers
    noise = std**2 * 0.5 * BOGIE.surveyed_wave
    edges = np.unique(np.round(np.geomspace(1, len(power), BOGIE.power_bands)).astype(int))
    middle = [float(np.mean(wavenumber[a:b])) for a, b in itertools.pairwise(edges)]
    level = [max(float(np.mean(power[a:b])), 1e-300) for a, b in itertools.pairwise(edges)]
    whole = np.exp(np.interp(wavenumber, middle, np.log(level)))
    share = np.clip(1.0 - noise / whole, 0.0, 1.0)
    found = np.fft.irfft(spectrum * share, 2 * n)[:n] + mean
    return replace(track, alignment=found)
