"""The windows of both axles of a bogie in; its uninterrupted runs over a known alignment out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import BogieRun
from estimation.motion.checks import direction, moving_samples, usable_samples
from estimation.motion.integration import IntegratedSegment, WindowParameters, integrate, standard_displacement
from estimation.motion.parameters import MOTION
from estimation.motion.window_motion import alignment_at
from estimation.values.arrays import BoolArray, FloatArray
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
    *,
    swapped: bool = False,
) -> Iterator[BogieRun]:
    """Yield the runs of both windows, of one time, in which all samples can be used."""
    axles = leading, trailing
    cutoff = min(BOGIE.longest_wave, track.cutoff_wavelength)
    facing = direction(leading.window) * (-1 if leading.window.backwards else 1)
    own = [facing * alignment_at(axle.distance, track, cutoff) for axle in axles]
    usable: BoolArray = np.ones(len(leading.window.valid), dtype=np.bool_)
    for axle, d in zip(axles, own, strict=True):
        window = replace(axle.window, distance=axle.distance)
        usable &= usable_samples(window, np.isfinite(d), layout, parameters.signals).samples
        usable &= moving_samples(axle.window, parameters.signals)
    both = [integrate(axle.window, usable, parameters.signals).segments for axle in axles]
    for pair in zip(*both, strict=True):
        ways = [
            _with_way_there(axle, segment, track, facing, cutoff) for axle, segment in zip(axles, pair, strict=True)
        ]
        place, ahead = np.stack(ways, axis=1)
        if np.isfinite(ahead).all():
            yield _run(pair[0], pair[1], ahead, place, facing, parameters, swapped=swapped)


def _with_way_there(
    axle: AxleWindow, segment: IntegratedSegment, track: TrackAlignment, facing: int, cutoff: float
) -> FloatArray:
    """Return place and d (2, k), m, of an axle over its run and a way before it at the speed of its begin."""
    at = axle.distance[segment.part]
    dt, speed = axle.window.sample_interval_s, float(segment.speed[0])
    step = np.sign(at[-1] - at[0]) * speed * dt
    before = at[0] + step * np.arange(-round(BOGIE.warm_up_m / (speed * dt)), 0)
    inside = np.clip(before, track.s[0], track.s[-1])  # a bogie that comes from off the section comes along its end
    place = np.concatenate([inside, at])
    d = facing * alignment_at(place, track, cutoff)
    known = np.isfinite(d)
    known[len(before) :] = True
    begin = d[known & np.isfinite(d)][0] if (known & np.isfinite(d)).any() else np.nan
    return np.stack([place, np.where(known, d, begin)])


def _run(
    leading: IntegratedSegment,
    trailing: IntegratedSegment,
    ahead: FloatArray,
    place: FloatArray,
    facing: int,
    parameters: WindowParameters,
    *,
    swapped: bool,
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
        stretch=1.0 + MOTION.hidden_roll_share if leading.level else 1.0,
        swapped=swapped,
        ahead=ahead,
        place=place,
        facing=facing,
    )
