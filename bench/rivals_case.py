"""One fleet on one track by every estimator: errors, intervals, processor time and size of the state."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from api.comparison.study import TrackInformation, TrueWheelset, on_file, read_truth
from api.comparison.trial import ESTIMATION, deploy, opened, parameters_of, receive, record, replayed, run_jobs
from estimation.contact.conicity import equivalent_conicity
from estimation.estimators.catalogue import estimators
from estimation.estimators.interface import CurveEstimate, EstimatorParameters, nothing
from estimation.jobs.job import JobContext
from estimation.jobs.refresh_geometry import geometries_of
from estimation.jobs.steps.rolling import members
from estimation.motion.integration import standard_displacement
from estimation.storage import UnitOfWork
from estimation.values.arrays import FloatArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason
from estimation.values.units import NORMAL_95
from estimation.values.windows import Motion
from ingest.simulator.axle_motion import contact_of
from ingest.simulator.campaign import scenario_track
from ingest.simulator.scenario import Scenario


@dataclass(frozen=True, slots=True)
class RivalScore:
    """One estimator, one wheelset, one track; None where an amplitude is not estimated."""

    family: str
    seed: int
    track: str
    estimator: str
    serial: str
    errors: tuple[float | None, ...]  # by amplitude of the truth, against the profiles
    errors_as_run: tuple[float | None, ...]  # the same against the table that the simulator ran on
    covered: tuple[bool, ...]  # of the estimated ones, by the published interval
    own_covered: tuple[bool, ...]  # of those, by the covariance that the estimator states; empty without one
    reason: str  # code why there is nothing; empty where there is something
    cpu_s: float
    running_s: float  # of valid samples
    state_bytes: int

    def as_json(self) -> dict[str, object]:
        """Return everything as JSON values."""
        return asdict(self)


def scores(
    scenario: Scenario,
    family: str,
    tracks: Sequence[TrackInformation],
    cache: Path,
    folder: Path,
    most: int,
    named: Sequence[str],
) -> Iterator[RivalScore]:
    """Yield the score of every estimator on every wheelset.

    Args:
        folder: For the data of deployments; empty.
    """
    recorded = record(scenario, cache, workers=1)
    truths = read_truth(recorded.truth)
    as_run = _as_run(scenario)
    shown = [truths[i] for i in np.unique(np.linspace(0, len(truths) - 1, min(most, len(truths))).astype(int))]
    for track in tracks:
        put = on_file(scenario, track)
        settings = deploy(put, folder / track.value)
        receive(recorded, settings)
        jobs = ESTIMATION[1:2] if track is TrackInformation.NONE else ESTIMATION[:2]
        with opened(settings) as (storage, context):
            run_jobs(context, jobs)
            for truth in shown:
                with storage.read() as unit:
                    parameters, motions = motions_of(unit, truth.serial, context)
                for name, found, cpu_s, size in _estimated(parameters, motions, named):
                    running_s = sum(float(motion.valid.sum()) * motion.sample_interval_s for motion in motions)
                    of = (family, scenario.seed, track.value, name)
                    yield _score(of, truth, as_run[truth.serial], found, (cpu_s, running_s, size))


def motions_of(unit: UnitOfWork, serial: str, context: JobContext) -> tuple[EstimatorParameters, list[Motion]]:
    """Return what an estimator of the jobs gets of a wheelset: parameters, and the motion of its windows."""
    found = geometries_of(unit, [serial], context)[serial]
    motions: list[Motion] = []
    parameters = EstimatorParameters(band_limited=True)
    for part in found.current_parts():
        used = found.estimated_with([part])
        parameters = parameters_of(used)
        motions += [motion for _, motion in replayed(unit, members(unit, found.rules, part), used.assumed.windows)]
    return parameters, motions


def _estimated(
    parameters: EstimatorParameters, motions: Sequence[Motion], named: Sequence[str]
) -> Iterator[tuple[str, CurveEstimate, float, int]]:
    """Yield name, result, processor time and bytes; where the first one says mismatch nothing else is published.

    The jobs do so: whatever the estimator, the data then do not follow the class of the vehicle.
    """
    mismatch: Reason | None = None
    first, *others = estimators()
    for estimator in (first, *(one for one in others if one.name in named)):
        began = time.process_time()
        state = estimator.init(parameters)
        for motion in motions:
            state = estimator.update(state, motion)
        found = estimator.result(state)
        cpu_s = time.process_time() - began
        if found.status is Status.MODEL_MISMATCH:
            mismatch = found.reason
        if mismatch is not None:
            found = nothing(mismatch, parameters, found.samples, found.stretches)
        yield estimator.name, found, cpu_s, _bytes(state)


def _bytes(value: object) -> int:
    """Return the bytes of all arrays in a frozen value."""
    if isinstance(value, np.ndarray):
        return int(value.nbytes)
    if isinstance(value, tuple):
        return sum(map(_bytes, value))
    names = [name for cls in type(value).__mro__ for name in getattr(cls, "__slots__", ())]
    return sum(_bytes(getattr(value, name)) for name in names)


def _as_run(scenario: Scenario) -> Mapping[str, tuple[FloatArray, FloatArray]]:
    """Return displacement and R by wheelset as the simulator's tables have them: straight between their points."""
    track, odometer = scenario_track(scenario), scenario.sessions.first_odometer
    found = {}
    for vehicle in scenario.vehicles:
        for plan in vehicle.wheelsets:
            table = contact_of(scenario, track, plan, odometer).table
            nominal = int(np.argmin(np.abs(table.gauge_deviation)))
            roll, radius = table.roll[:, nominal], plan.nominal_radius
            standard = standard_displacement(table.lateral_displacement, roll, radius, level=False)
            found[plan.serial] = standard, table.rolling_radius_difference[:, nominal]
    return found


def _score(
    of: tuple[str, int, str, str],
    truth: TrueWheelset,
    as_run: tuple[FloatArray, FloatArray],
    found: CurveEstimate,
    cost: tuple[float, float, int],
) -> RivalScore:
    ran = equivalent_conicity(*as_run, truth.amplitude)
    errors: list[float | None] = []
    errors_as_run: list[float | None] = []
    covered, own_covered = [], []
    for amplitude, true, run in zip(truth.amplitude, truth.conicity, ran, strict=True):
        at = int(np.argmin(np.abs(found.amplitude - amplitude)))
        one = found.conicity[at]
        if one.value is None or one.low is None or one.high is None:
            errors.append(None)
            errors_as_run.append(None)
            continue
        errors.append(float(one.value - true))
        errors_as_run.append(float(one.value - run))
        covered.append(bool(one.low <= true <= one.high))
        own = np.nan if found.own_std is None else float(found.own_std[at])
        if np.isfinite(own):
            own_covered.append(bool(abs(one.value - true) <= NORMAL_95 * own))
    reason = "" if found.reason is None else str(found.reason.code)
    family, seed, track, name = of
    return RivalScore(
        family, seed, track, name, truth.serial, tuple(errors), tuple(errors_as_run),
        tuple(covered), tuple(own_covered), reason, *cost,
    )  # fmt: skip
