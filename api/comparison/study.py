"""Every estimator on the windows of one fleet, with its track known, found by the fleet, and unknown."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from api.comparison.trial import (
    ESTIMATION,
    Progress,
    copied,
    deploy,
    geometry_by,
    no_progress,
    opened,
    receive,
    record,
    register,
    run_jobs,
)
from estimation.estimators.catalogue import estimators
from estimation.jobs.job import JobContext
from estimation.storage import Storage
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.geometry import WheelsetGeometry
from ingest.simulator.scenario import Scenario
from ingest.simulator.section import SurveyPlan

AMPLITUDES = tuple(float(a) for a in np.arange(4, 13) * 0.25e-3)  # m: 1.0 to 3.0 mm


@dataclass(frozen=True, slots=True)
class TrueWheelset(FrozenArrays):
    """The true geometry of a wheelset at nominal gauge."""

    serial: str
    displacement: Annotated[FloatArray, "n"]  # m, y - d
    difference: Annotated[FloatArray, "n"]  # m, rL - rR
    radius_sum: Annotated[FloatArray, "n"]  # m
    angle_sum: Annotated[FloatArray, "n"]  # rad
    angle_difference: Annotated[FloatArray, "n"]  # rad
    amplitude: Annotated[FloatArray, "k"]  # m: ``AMPLITUDES``
    conicity: Annotated[FloatArray, "k"]  # NaN where it has none
    nonlinearity: float  # 1/mm
    zero_crossing: float  # m


def read_truth(path: Path) -> tuple[TrueWheelset, ...]:
    """Return what is true of every wheelset in the first campaign of a simulation, in the order of their serials."""
    wheelsets = json.loads(path.read_text(encoding="utf-8"))["wheelsets"]
    found = [_wheelset(item["serial"], run) for item in wheelsets for run in item["campaigns"] if run["campaign"] == 1]
    return tuple(sorted(found, key=lambda item: item.serial))


def conicity_errors(geometry: WheelsetGeometry, truth: TrueWheelset) -> list[tuple[float, bool] | None]:
    """Return error and whether the 95 % interval holds the truth at each amplitude of the truth; None: no estimate."""
    compared: list[tuple[float, bool] | None] = []
    for amplitude, true in zip(truth.amplitude, truth.conicity, strict=True):
        nearest = int(np.argmin(np.abs(geometry.amplitude - amplitude)))
        estimate = geometry.conicity[nearest]
        same = bool(np.isclose(geometry.amplitude[nearest], amplitude, rtol=0.0, atol=1e-9))
        if not same or estimate.value is None or estimate.low is None or estimate.high is None:
            compared.append(None)
        else:
            compared.append((float(estimate.value - true), bool(estimate.low <= true <= estimate.high)))
    return compared


def _wheelset(serial: str, facts: dict[str, Any]) -> TrueWheelset:
    conicity = np.array([np.nan if value is None else value for value in facts["equivalent_conicity"]])
    amplitudes = 1e-3 * np.array(facts["amplitude_mm"])
    chosen = [int(np.argmin(np.abs(amplitudes - amplitude))) for amplitude in AMPLITUDES]
    return TrueWheelset(
        serial=serial,
        displacement=1e-3 * np.array(facts["lateral_displacement_mm"]),
        difference=1e-3 * np.array(facts["rolling_radius_difference_mm"]),
        radius_sum=1e-3 * np.array(facts["rolling_radius_sum_mm"]),
        angle_sum=np.array(facts["contact_angle_sum_rad"]),
        angle_difference=np.array(facts["contact_angle_difference_rad"]),
        amplitude=np.array(AMPLITUDES),
        conicity=conicity[chosen],
        nonlinearity=_number(facts["nonlinearity_parameter"]),
        zero_crossing=1e-3 * _number(facts["zero_crossing_mm"]),
    )


def _number(value: float | None) -> float:
    return float("nan") if value is None else value


class TrackInformation(StrEnum):
    """What is on file of the track."""

    KNOWN = "known"  # its true alignment and gauge
    FLEET = "fleet"  # no alignment: the alignment job finds it; gauge as in the scenario
    NONE = "none"  # a straight track: y is taken for y - d


@dataclass(frozen=True, slots=True)
class Score:
    """How near one estimator came for all wheelsets of a run, with one information on the track."""

    pair: str
    track: TrackInformation
    estimator: str
    by_wheelset: tuple[float, ...]  # mean absolute error over the amplitudes estimated, NaN without any
    wheelsets: int
    amplitudes: int  # asked for, over all wheelsets
    estimated: int  # of these
    covered: int  # of the estimated: the interval holds the truth
    seconds: float  # from stored windows or tables to geometries, all wheelsets

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
    """One wheelset, shown in full: its truth, and its geometries by track information and estimator."""

    truth: TrueWheelset
    geometries: Mapping[tuple[TrackInformation, str], WheelsetGeometry]


@dataclass(frozen=True, slots=True)
class PairStudy:
    """What came out for one run."""

    pair: str
    seed: int
    scores: tuple[Score, ...]
    unestimated: Mapping[TrackInformation, str]  # why there is no geometry at all
    track_seconds: float  # of the alignment job, on the fleet's track
    example: Example


def study(scenario: Scenario, cache: Path, progress: Progress = no_progress) -> PairStudy:
    """Compare the estimators on one seed of a scenario.

    The recordings are received once. Alignment, windows and geometries are those of the scheduled jobs; each estimator
    of the catalogue gets the same stored windows and versions of the alignment.
    """

    def show(what: str, done: int, of: int) -> None:
        progress(f"{scenario.pair}: {what}", done, of)

    recorded = record(scenario, cache, progress=show)
    truths = read_truth(recorded.truth)
    shown = truths[3 * len(truths) // 4]
    scores: list[Score] = []
    unestimated: dict[TrackInformation, str] = {}
    geometries: dict[tuple[TrackInformation, str], WheelsetGeometry] = {}
    track_seconds = 0.0
    with tempfile.TemporaryDirectory(prefix="treadwatch-compare-") as temporary:
        received = deploy(on_file(scenario, TrackInformation.FLEET), Path(temporary) / "received")
        receive(recorded, received, show)
        for track in TrackInformation:
            folder = Path(temporary) / track.value
            settings = copied(received, folder)
            register(on_file(scenario, track), settings, folder)
            with opened(settings) as (storage, context):
                began = time.perf_counter()
                jobs = ESTIMATION[1:] if track is TrackInformation.NONE else ESTIMATION
                run_jobs(context, jobs[:1], show)
                if track is TrackInformation.FLEET:
                    track_seconds = time.perf_counter() - began
                run_jobs(context, jobs[1:], show)
                for score, of_wheelsets in _scored(storage, context, scenario.pair, track, truths, show):
                    scores.append(score)
                    if (geometry := of_wheelsets[shown.serial]) is not None:
                        geometries[track, score.estimator] = geometry
                if sum(score.track is track for score in scores) < len(estimators()):
                    unestimated[track] = _why(storage, truths)
    example = Example(shown, geometries)
    return PairStudy(scenario.pair, scenario.seed, tuple(scores), unestimated, track_seconds, example)


def on_file(scenario: Scenario, track: TrackInformation) -> Scenario:
    """Return the scenario whose registry holds ``track``; its recordings are the same."""
    section = scenario.section
    if track is TrackInformation.FLEET:
        return replace(scenario, section=replace(section, surveyed=False))
    surveyed = replace(section, surveyed=True)
    if track is TrackInformation.NONE and section.recipe is not None:
        straight = section.recipe.without_irregularities()
        surveyed = replace(
            surveyed, recipe=straight, survey_alignment_std=0.0, survey_gauge_std=0.0, survey=SurveyPlan()
        )
    return replace(scenario, section=surveyed)


def _scored(
    storage: Storage,
    context: JobContext,
    pair: str,
    track: TrackInformation,
    truths: Sequence[TrueWheelset],
    progress: Progress,
) -> Iterator[tuple[Score, Mapping[str, WheelsetGeometry | None]]]:
    """Yield the score of each estimator with its geometries, until one finds none at all."""
    every = estimators()
    for done, item in enumerate(every):
        progress(f"track {track}: {item.title}", done, len(every))
        began = time.perf_counter()
        geometries = {truth.serial: geometry_by(storage, context, truth.serial, item.name) for truth in truths}
        seconds = time.perf_counter() - began
        if not any(geometries.values()):
            return
        pairs = [(geometries[truth.serial], truth) for truth in truths]
        errors = [[] if estimate is None else conicity_errors(estimate, truth) for estimate, truth in pairs]
        compared = [[error for error in of_wheelset if error] for of_wheelset in errors]
        score = Score(
            pair=pair,
            track=track,
            estimator=item.name,
            by_wheelset=tuple(float(np.mean([abs(e) for e, _ in each])) if each else float("nan") for each in compared),
            wheelsets=len(truths),
            amplitudes=sum(len(truth.amplitude) for truth in truths),
            estimated=sum(map(len, compared)),
            covered=sum(inside for each in compared for _, inside in each),
            seconds=seconds,
        )
        yield score, geometries


def _why(storage: Storage, truths: Sequence[TrueWheelset]) -> str:
    with storage.read() as unit:
        newest = unit.windows.latest(truths[0].serial)
    if newest is None:
        return "no window"
    return f"windows are {newest.state}" if newest.reason is None else str(newest.reason)
