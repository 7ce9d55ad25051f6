"""What a scenario draws along its track beside alignment and gauge: cross level, friction, vertical load."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.special import ndtr

from estimation.errors import ParameterError
from estimation.values.arrays import FloatArray
from ingest.simulator.irregularity import Waves, superpose
from ingest.simulator.random_streams import Stream, generator
from ingest.simulator.running import STRETCH_END, FrictionPlan, FrictionStretch, RunningPlan
from ingest.simulator.track import Surface, TrackTruth

RAIL_DISTANCE = 1.5  # m, over which cross level is measured (EN 13848-1)
LEAST_LOAD = 0.2  # of the mean: wheels stay on the rails


def with_surface(track: TrackTruth, plan: RunningPlan, seed: int) -> TrackTruth:
    """Return the track with what the scenario draws along it; each has a random stream of its own."""
    if not plan.changes_the_track:
        return track
    n = len(track.s)
    roll, friction, load = np.zeros(n), np.ones(n), np.ones(n)
    if plan.cross_level is not None:
        roll = _drawn(track, plan.cross_level, generator(seed, Stream.CROSS_LEVEL), "cross_level") / RAIL_DISTANCE
    if plan.friction is not None:
        friction = friction_along(plan.friction, n, track.interval, generator(seed, Stream.FRICTION))
        friction = friction / plan.creep.friction
    if plan.load_variation is not None:
        varied = 1.0 + _drawn(track, plan.load_variation, generator(seed, Stream.LOAD), "load_variation")
        load = np.maximum(varied, LEAST_LOAD)
    return replace(track, surface=Surface(roll, friction, load))


def friction_along(plan: FrictionPlan, n: int, interval: float, rng: np.random.Generator) -> FloatArray:
    """Return the coefficient of friction (n,): every value between the limits is as frequent, changes are smooth."""
    width = plan.correlation / interval
    reach = int(np.ceil(4.0 * width))
    smooth = gaussian_filter1d(rng.standard_normal(n + 2 * reach), width, mode="wrap")[reach : reach + n]
    scale = np.sqrt(2.0 * np.sqrt(np.pi) * width)  # of white noise that is smoothed so
    return np.asarray(plan.lowest + (plan.highest - plan.lowest) * ndtr(scale * smooth))


def friction_factor(plan: RunningPlan, seed: int, campaign: int) -> float:
    """Return by what the coefficient of friction is multiplied in a campaign (from 0): rails are dry, wet or dirty."""
    if plan.friction is None or plan.friction.campaign_std == 0.0:
        return 1.0
    return float(np.exp(plan.friction.campaign_std * generator(seed, Stream.FRICTION, campaign).standard_normal()))


def with_stretches(track: TrackTruth, plan: RunningPlan, campaign: int, mean_friction: float) -> TrackTruth:
    """Return the track of one campaign: with the stretches of another friction that there are by then.

    Args:
        mean_friction: What the friction of the track is over, in that campaign.
    """
    there = [one for one in plan.stretches if campaign + 1 >= one.from_campaign]
    if not there:
        return track
    flat = np.ones(len(track.s))
    surface = track.surface or Surface(np.zeros(len(track.s)), flat, flat)
    friction = surface.friction
    for one in there:
        inside = _inside(one, track.s)
        friction = friction + inside * (one.friction / mean_friction - friction)
    return replace(track, surface=replace(surface, friction=friction))


def _inside(stretch: FrictionStretch, s: FloatArray) -> FloatArray:
    """Return 1 in a stretch and 0 beside it (n,), smooth at both ends so that the spline of the track is."""
    depth = np.clip(np.minimum(s - stretch.begin, stretch.end - s) / STRETCH_END, 0.0, 1.0)
    return np.asarray(depth * depth * (3.0 - 2.0 * depth))


def _drawn(track: TrackTruth, waves: Waves, rng: np.random.Generator, key: str) -> FloatArray:
    try:
        values = superpose([waves], [rng], length=track.length, interval=track.interval)
    except ParameterError as error:
        raise ParameterError(error.reason, field=f"section.{key}") from error
    return np.asarray(np.interp(track.s - track.s[0], track.interval * np.arange(len(values)), values))
