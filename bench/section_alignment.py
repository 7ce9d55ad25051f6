"""The alignment that the fleet has found against the true one, in a band of wavelengths."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.filters import high_pass, local_cubic_kernel
from estimation.motion.window_motion import deconvolved
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.track import TrackAlignment
from estimation.values.units import NORMAL_95
from ingest.simulator.campaign import scenario_track, vehicle_run
from ingest.simulator.scenario import Scenario
from ingest.simulator.track import TrackTruth

BAND = (3.0, 60.0)  # m of wavelength
ENDS = 300.0  # m of the section that are left out at each end

STEPS = 6  # of the fit of place and stretch


@dataclass(frozen=True, slots=True)
class AlignmentScore:
    """Error of the alignment; SD in m."""

    band: float  # 3-60 m of wavelength
    filtered: float  # as published, against the truth behind the same filter
    signal: float  # SD of the true alignment in the band
    published: int  # places
    covered: int  # of these, by the 95 % interval
    known: float  # share of the section
    gauge: float = 0.0  # of an estimated gauge deviation
    gauge_published: int = 0  # places
    gauge_covered: int = 0


def alignment_score(scenario: Scenario, found: TrackAlignment) -> AlignmentScore:
    """Return the error of an alignment, its offset and scale along the track fitted: no data determine these."""
    true_track = scenario_track(scenario)
    grid, step = found.s, float(found.s[1] - found.s[0])
    inner = (grid > ENDS) & (grid < grid[-1] - ENDS) & np.isfinite(found.alignment)
    own = np.isfinite(found.cutoff_wavelength)
    weights = local_cubic_kernel(found.cutoff_wavelength, step) if own else None

    def truth(s: FloatArray) -> FloatArray:
        return np.interp(s, true_track.s, true_track.alignment)

    def filtered(values: FloatArray) -> FloatArray:
        return values if weights is None else high_pass(values, weights)

    place = _fitted(scenario, found, inner, lambda s: filtered(truth(s)))
    error = (found.alignment - filtered(truth(place)))[inner]
    true_band = in_band(truth(place), step)
    fullest = found.alignment if found.cutoff_wavelength >= 2.0 * BAND[1] else deconvolved(found)
    known = np.isfinite(fullest)
    whole = np.interp(grid, grid[known], fullest[known])
    inside = np.abs(error - error.mean()) <= NORMAL_95 * found.alignment_std[inner]
    return AlignmentScore(
        band=float((in_band(whole, step) - true_band)[inner & known].std()),
        filtered=float(error.std()),
        signal=float(true_band[inner].std()),
        published=int(inner.sum()),
        covered=int(inside.sum()),
        known=float(np.isfinite(found.alignment).mean()),
        **_gauge_score(true_track, found, place, inner),
    )


def _gauge_score(true_track: TrackTruth, found: TrackAlignment, place: FloatArray, inner: BoolArray) -> dict[str, Any]:
    """Return the error of an estimated gauge deviation, m SD, and how many of its intervals cover; its mean is lost."""
    if found.gauge_known or not found.gauge_deviation.any():
        return {}
    true = np.interp(place, true_track.s, true_track.gauge_deviation)[inner]
    error = found.gauge_deviation[inner] - true
    error -= error.mean()
    covered = np.abs(error) <= NORMAL_95 * found.gauge_deviation_std[inner]
    return {"gauge": float(error.std()), "gauge_published": len(error), "gauge_covered": int(covered.sum())}


def _fitted(
    scenario: Scenario, found: TrackAlignment, inner: BoolArray, truth: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Return the true place (n,), m, of every grid point: that of the mean journey, then by least squares."""
    grid = found.s
    if not (scenario.position.offset or scenario.position.scale):
        return grid
    centre = 0.5 * float(grid[0] + grid[-1])
    offset, scale = _mean_position_error(scenario, centre)
    for _ in range(STEPS):
        place = grid - offset - scale * (grid - centre)
        d = truth(place)
        slope = np.gradient(d, grid)
        design = np.column_stack([slope, slope * (grid - centre)])[inner]
        moved, stretched = np.linalg.lstsq(design, (d - found.alignment)[inner], rcond=None)[0]
        offset, scale = offset + float(moved), scale + float(stretched)
    return np.asarray(grid - offset - scale * (grid - centre))


def _mean_position_error(scenario: Scenario, centre: float) -> tuple[float, float]:
    """Return offset at ``centre``, m, and scale of the reported positions, mean of all runs."""
    track, errors = scenario_track(scenario), []
    for vehicle in scenario.vehicles:
        for campaign in range(scenario.sessions.campaigns):
            run = vehicle_run(scenario, track, vehicle, campaign)
            error = run.reported - run.distance
            scale = (error[-1] - error[0]) / (run.distance[-1] - run.distance[0])
            errors.append((float(np.interp(centre, run.distance, error)), float(scale)))
    offset, mean_scale = np.mean(errors, axis=0)
    return float(offset), float(mean_scale)


def in_band(values: FloatArray, step: float) -> FloatArray:
    """Return ``values`` (n,) without what is outside ``BAND``; within ``ENDS`` of its ends it is faded out."""
    n = len(values)
    fade = np.clip(np.arange(n) * step / (0.5 * ENDS), 0.0, 1.0)
    window = np.sin(0.5 * np.pi * fade) ** 2 * np.sin(0.5 * np.pi * fade[::-1]) ** 2
    spectrum = np.fft.rfft((values - values.mean()) * window)
    wavenumber = np.fft.rfftfreq(n, step)
    keep = (wavenumber >= 1.0 / BAND[1]) & (wavenumber <= 1.0 / BAND[0])
    return np.fft.irfft(np.where(keep, spectrum, 0.0), n)
