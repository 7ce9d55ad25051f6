"""The track as it is on file: the truth with errors of a survey, or a survey that does not belong to the section."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.errors import ScenarioError
from estimation.values.arrays import FloatArray
from ingest.simulator.campaign import with_margins
from ingest.simulator.random_streams import Stream, generator, seed_of
from ingest.simulator.scenario import Scenario
from ingest.simulator.track import TrackTruth, from_zero, make_track, read_track

LEAST_SHARE = 0.9  # of the section that the survey of another one must cover


def surveyed(scenario: Scenario, track: TrackTruth) -> TrackTruth:
    """Return the track that is on file of the scenario's section, its curves as built.

    The survey's own errors are white, of the survey's standard deviations, smoothed over some 2 m as a chord does. The
    other ways in which it may be wrong come before them: another section, of all or of the gauge alone, a shift along
    the track, a factor.

    Raises:
        ScenarioError: The file of another section cannot be read, or is too short.
    """
    plan, section = scenario.section.survey, scenario.section
    source = track
    if plan.other_section or plan.gauge_other_section:
        other = _other_section(scenario, track)
        source = other if plan.other_section else replace(track, gauge_deviation=other.gauge_deviation)
    if plan.shift:
        source = _shifted(source, plan.shift)
    rng = generator(scenario.seed, Stream.SURVEY)
    alignment_error = _error(len(track.s), section.survey_alignment_std, track.interval, rng)
    gauge_error = _error(len(track.s), section.survey_gauge_std, track.interval, rng)
    alignment, gauge = plan.alignment_factor * source.alignment, plan.gauge_factor * source.gauge_deviation
    if not plan.gauge:
        gauge, gauge_error = np.zeros_like(gauge), np.zeros_like(gauge)
    return TrackTruth(track.s, alignment + alignment_error, gauge + gauge_error, track.curves)


def _other_section(scenario: Scenario, track: TrackTruth) -> TrackTruth:
    """Return another section on the grid of ``track``: in a file, or of the same recipe with another seed."""
    section = scenario.section
    if section.survey.file is None:
        assert section.recipe is not None
        return make_track(with_margins(scenario, section.recipe), seed_of(scenario.seed, Stream.OTHER_SECTION))
    other = from_zero(read_track(section.survey.file))
    if other.length < LEAST_SHARE * track.length:
        reason = f"has {other.length:.0f} m of track, the section {track.length:.0f} m"
        raise ScenarioError(reason, file=section.survey.file, field="section.survey.file")
    return _on_grid(other, track.s)


def _shifted(track: TrackTruth, shift: float) -> TrackTruth:
    """Return a track whose irregularities are ``shift`` m further on; at its ends the first and last value."""
    return replace(_on_grid(track, track.s - shift), s=track.s)


def _on_grid(track: TrackTruth, s: FloatArray) -> TrackTruth:
    at = np.clip(s, track.s[0], track.s[-1])
    values = CubicSpline(track.s, np.column_stack([track.alignment, track.gauge_deviation]))(at)
    return TrackTruth(s, values[:, 0], values[:, 1])


def _error(n: int, std: float, interval: float, rng: np.random.Generator) -> FloatArray:
    white = rng.standard_normal(n)
    if std == 0.0:
        return np.zeros(n)
    window = np.hanning(max(3, round(4.0 / interval)))
    return np.asarray(std * np.convolve(white, window / np.sqrt((window**2).sum()), mode="same"))
