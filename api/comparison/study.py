"""Run every estimator on the windows of a section, with known track, with the fleet's alignment, and without."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from estimation.estimators.catalogue import estimators
from estimation.estimators.interface import CurveEstimate, Estimator, EstimatorParameters
from estimation.estimators.tracks import TrackKnowledge, fleet_knowledge, motions, section_passes, straight_track
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.settings import EstimationSettings
from estimation.track.settings import AlignmentSettings
from estimation.values.motion import Motion
from estimation.values.track import TrackAlignment
from ingest.simulator.section_run import SECTION, SectionRun, WheelsetTruth

Progress = Callable[[str, int, int], None]  # what, done, of


class Told(StrEnum):
    """What the estimators are told of the track."""

    KNOWN = "known"  # its true alignment, and where that puts the passes
    FLEET = "fleet"  # what the passes of the fleet say
    NOTHING = "none"  # y is taken for y - d


@dataclass(frozen=True, slots=True)
class Score:
    """How one estimator did on all wheelsets of a run, told one thing of the track."""

    pair: str
    told: Told
    estimator: str
    by_wheelset: tuple[float, ...]  # mean absolute error over the amplitudes estimated, NaN without any
    wheelsets: int
    amplitudes: int  # asked for, over all wheelsets
    estimated: int  # of these
    covered: int  # of the estimated: the interval holds the truth
    seconds: float  # of init, update and result, all wheelsets

    @property
    def errors(self) -> tuple[float, ...]:
        """Errors of the wheelsets with any estimate."""
        return tuple(error for error in self.by_wheelset if np.isfinite(error))

    @property
    def median(self) -> float:
        """Median of the errors; NaN without any."""
        return float(np.median(self.errors)) if self.errors else float("nan")

    @property
    def p95(self) -> float:
        """95th percentile of the errors; NaN without any."""
        return float(np.quantile(self.errors, 0.95)) if self.errors else float("nan")

    @property
    def coverage(self) -> float:
        """Share of the intervals that hold the truth; NaN without any."""
        return self.covered / self.estimated if self.estimated else float("nan")


@dataclass(frozen=True, slots=True)
class Example:
    """One wheelset, shown in full: its truth, and the curves by what was told and by estimator."""

    truth: WheelsetTruth
    curves: Mapping[tuple[Told, str], CurveEstimate]


@dataclass(frozen=True, slots=True)
class PairStudy:
    """What came out for one run."""

    pair: str
    seed: int
    scores: tuple[Score, ...]
    untold: Mapping[Told, str]  # why the estimators could not be told
    track_seconds: float  # of the fleet's alignment
    example: Example


def study(run: SectionRun, progress: Progress = lambda _what, _done, _of: None) -> PairStudy:
    """Compare the estimators on one run of a section.

    Parameters
    ----------
    run
        The simulated section; the estimators see its windows, the scores its truth.
    progress
        Told what is being done, and how far it is.
    """
    settings, alignment = EstimationSettings(), AlignmentSettings()
    progress(f"{run.pair.name}: passes", 0, 1)
    began = time.perf_counter()
    knowledge, untold = _told(run, settings, alignment, progress)
    track_seconds = time.perf_counter() - began
    parameters = {told: _parameters(run, known.track, settings) for told, known in knowledge.items()}
    every = estimators()
    tallies = {(told, item.name): _Tally() for told in knowledge for item in every}
    shown = run.wheelsets[3 * len(run.wheelsets) // 4]
    curves: dict[tuple[Told, str], CurveEstimate] = {}
    for done, truth in enumerate(run.wheelsets):
        progress(f"{run.pair.name}: estimate", done, len(run.wheelsets))
        for told, known in knowledge.items():
            moved = list(motions(run.windows(truth.serial), known, settings.windows))
            for item in every:
                found = tallies[told, item.name].add(item, parameters[told], moved, truth)
                if truth is shown:
                    curves[told, item.name] = found
    scores = tuple(tally.score(run.pair.name, told, name) for (told, name), tally in tallies.items())
    progress(f"{run.pair.name}: estimate", len(run.wheelsets), len(run.wheelsets))
    return PairStudy(run.pair.name, run.seed, scores, untold, track_seconds, Example(shown, curves))


def _parameters(run: SectionRun, track: TrackAlignment, settings: EstimationSettings) -> EstimatorParameters:
    """Return what estimators assume: vehicles uncertain where the simulated ones are, and what the track taught."""
    assumed = settings.geometry.uncertainty if run.scenario.errors_drawn else ParameterUncertainty(0.0, 0.0, 0.0)
    return EstimatorParameters(
        vehicle=settings.vehicle,
        uncertainty=assumed.on([track]),
        curve=settings.geometry.curve,
        source=settings.signals.source,
        band_limited=True,
    )


def _told(
    run: SectionRun, settings: EstimationSettings, alignment: AlignmentSettings, progress: Progress
) -> tuple[dict[Told, TrackKnowledge], dict[Told, str]]:
    """Return what can be told of the track, and why what cannot."""
    scenario, true = run.scenario, run.true_track()
    found = section_passes(run.all_windows(), settings.windows, alignment)
    progress(f"{run.pair.name}: alignment of the fleet", 0, 1)
    gauge_only = run.known_gauge()
    answers: dict[Told, TrackKnowledge | str] = {
        Told.KNOWN: TrackKnowledge(true),
        Told.FLEET: fleet_knowledge(found, gauge_only, SECTION, scenario.length, alignment, run.measured()),
        Told.NOTHING: TrackKnowledge(straight_track(SECTION, scenario.length)),
    }
    if scenario.position_offset or scenario.position_scale:
        progress(f"{run.pair.name}: passes on the known track", 0, 1)
        placed = fleet_knowledge(found, true, SECTION, scenario.length, alignment)
        answers[Told.KNOWN] = placed if isinstance(placed, str) else TrackKnowledge(true, placed.found)
    knowledge = {told: answer for told, answer in answers.items() if not isinstance(answer, str)}
    return knowledge, {told: answer for told, answer in answers.items() if isinstance(answer, str)}


class _Tally:
    """Collects the errors of one estimator, wheelset by wheelset."""

    def __init__(self) -> None:
        self._errors: list[float] = []
        self._wheelsets = self._amplitudes = self._estimated = self._covered = 0
        self._seconds = 0.0

    def add(
        self, estimator: Estimator[Any], parameters: EstimatorParameters, moved: Sequence[Motion], truth: WheelsetTruth
    ) -> CurveEstimate:
        """Run ``estimator`` on the motion of one wheelset, and hold its result against the truth."""
        began = time.perf_counter()
        state = estimator.init(parameters)
        for motion in moved:
            state = estimator.update(state, motion)
        found = estimator.result(state)
        self._seconds += time.perf_counter() - began
        compared = against_truth(found, truth)
        self._wheelsets += 1
        self._amplitudes += len(truth.amplitude)
        self._estimated += len(compared)
        self._covered += sum(inside for _, inside in compared)
        self._errors.append(float(np.mean([abs(error) for error, _ in compared])) if compared else float("nan"))
        return found

    def score(self, pair: str, told: Told, estimator: str) -> Score:
        """Return what was collected."""
        return Score(
            pair=pair,
            told=told,
            estimator=estimator,
            by_wheelset=tuple(self._errors),
            wheelsets=self._wheelsets,
            amplitudes=self._amplitudes,
            estimated=self._estimated,
            covered=self._covered,
            seconds=self._seconds,
        )


def against_truth(found: CurveEstimate, truth: WheelsetTruth) -> list[tuple[float, bool]]:
    """Return error and whether the interval holds the truth, for every amplitude of the truth that is estimated."""
    compared = []
    for amplitude, true in zip(truth.amplitude, truth.conicity, strict=True):
        at = int(np.argmin(np.abs(found.amplitude - amplitude)))
        estimate = found.conicity[at]
        same = bool(np.isclose(found.amplitude[at], amplitude, rtol=0.0, atol=1e-9))
        if same and estimate.value is not None and estimate.low is not None and estimate.high is not None:
            compared.append((float(estimate.value - true), bool(estimate.low <= true <= estimate.high)))
    return compared
