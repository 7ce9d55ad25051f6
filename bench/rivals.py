"""Rival estimators on the same windows: ``python -m bench rivals [--seeds 0-19] [--families smooth,P8/113A] ...``.

Every fleet is recorded, received and its windows made by the scheduled jobs; then every estimator of the catalogue gets
the same motion (``rivals_case``).
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from api.comparison.study import TrackInformation, TrueWheelset, on_file, read_truth
from api.comparison.trial import ESTIMATION, deploy, opened, parameters_of, receive, record, replayed, run_jobs
from bench.report import BenchRow, Part, ResultTable, row_table
from bench.scores import Cluster, Compared, compared_at, figures_table
from bench.study import Case, Key, Study, one_of
from estimation.contact.conicity import equivalent_conicity
from estimation.contact.profiles import wheel_profile
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
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.drawn_plan import ProfilePair
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import load_scenario


@dataclass(frozen=True, slots=True)
class RivalScore:
    """One estimator, one wheelset, one track; None where an amplitude is not estimated."""

    family: str
    seed: int
    track: str
    estimator: str
    serial: str
    compared: tuple[Compared | None, ...]  # by amplitude of the truth, against the profiles
    errors: tuple[float | None, ...]  # of these
    errors_as_run: tuple[float | None, ...]  # the same against the table that the simulator ran on
    own_covered: tuple[
        bool, ...
    ]  # of the estimated ones, by the covariance that the estimator states; empty without one
    reason: str  # code why there is nothing; empty where there is something
    cpu_s: float
    running_s: float  # of valid samples
    state_bytes: int


def scores(scenario: Scenario, family: str, tracks: Sequence[TrackInformation], folder: Path) -> Iterator[RivalScore]:
    """Yield the score of every estimator on every wheelset."""
    recorded = record(scenario, folder / "recordings", workers=1)
    truths, as_run = read_truth(recorded.truth), _as_run(scenario)
    for track in tracks:
        put = on_file(scenario, track)
        settings = deploy(put, folder / track.value)
        receive(recorded, settings)
        jobs = ESTIMATION[1:2] if track is TrackInformation.NONE else ESTIMATION[:2]
        with opened(settings) as (storage, context):
            run_jobs(context, jobs)
            for truth in truths:
                with storage.read() as unit:
                    parameters, motions = motions_of(unit, truth.serial, context)
                for name, found, cpu_s, size in _estimated(parameters, motions):
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
        windows = replayed(unit, members(unit, found.rules, part), used.assumed.window_parameters)
        motions += [motion for _, motion in windows]
    return parameters, motions


def _estimated(
    parameters: EstimatorParameters, motions: Sequence[Motion]
) -> Iterator[tuple[str, CurveEstimate, float, int]]:
    """Yield name, result, processor time and bytes; where the first one says mismatch nothing else is published.

    The jobs do so: whatever the estimator, the data then do not follow the class of the vehicle.
    """
    mismatch: Reason | None = None
    for estimator in estimators():
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
    own_std = np.full(len(found.amplitude), np.nan) if found.own_std is None else found.own_std
    scored = compared_at(truth.amplitude, truth.conicity, found.amplitude, found.conicity)
    at = [int(np.argmin(np.abs(found.amplitude - amplitude))) for amplitude in truth.amplitude]
    given = [(one, float(own_std[place])) for one, place in zip(scored, at, strict=True) if one is not None]
    errors = tuple(None if one is None else one.error for one in scored)
    shift = truth.conicity - ran
    errors_as_run = tuple(None if one is None else one + float(off) for one, off in zip(errors, shift, strict=True))
    own_covered = tuple(abs(one.error) <= NORMAL_95 * own for one, own in given if np.isfinite(own))
    reason = "" if found.reason is None else str(found.reason.code)
    family, seed, track, name = of
    return RivalScore(
        family, seed, track, name, truth.serial, tuple(scored), errors, errors_as_run, own_covered, reason, *cost,
    )  # fmt: skip


SMOOTH, JUMPS = "smooth", "P8/113A"
FAMILIES = (SMOOTH, JUMPS)
STEP = 0.005e-3  # m between points of contact tables: contact jumps are where the profiles have them
ROOT = -33.0  # mm, in the flange: a corner, where no tread is
STEEPNESS = (0.06, 0.16)  # of the treads, from the first wheelset to the last
CUBIC = 300e-6  # 1/mm2, by which treads are steeper towards the flange
ON_TREAD = 8.0  # mm from the datum to either side, within which the tread is cubic; straight beyond


def fleet(family: str, seed: int, vehicles: int, wheels: Path) -> Scenario:
    """Return the fleet of the accuracy table, on known track, with the wheels of a family."""
    scenario = load_scenario("known")
    drawn = scenario.drawn
    assert drawn is not None  # the built-in scenario draws its fleet
    pair = next(item for item in drawn.pairs if item.name == JUMPS)
    if family == SMOOTH:
        pair = _smooth_pair(pair, 4 * vehicles, wheels)
    plan = replace(drawn, given_vehicles=vehicles, pairs=(pair,))
    finer = replace(scenario.wheels, contact_step=STEP)
    return with_seed(replace(scenario, name=f"rivals {family}", drawn=plan, wheels=finer), seed)


def _smooth_pair(pair: ProfilePair, wheelsets: int, folder: Path) -> ProfilePair:
    """Return smooth wheels, one pair of files a wheelset, on the rail of ``pair``."""
    folder.mkdir(parents=True, exist_ok=True)
    files = []
    for rank, steepness in enumerate(np.linspace(*STEEPNESS, wheelsets)):
        path = folder / f"smooth-{rank}-of-{wheelsets}.whl"
        path.write_text(_wheel(float(steepness)), encoding="ascii")
        files.append((path, path))
    return replace(pair, name="smooth", deepest_wear=0.0, wheel_files=tuple(files))


def _wheel(steepness: float) -> str:
    """Return a wheel as a MiniProf file: the flange of a P8, and a tread without any edge."""
    y = np.arange(-69.9, 60.0, 0.25)
    flange = 1e3 * wheel_profile("P8").height(1e-3 * y)
    near = np.clip(y, -ON_TREAD, ON_TREAD)
    fall = steepness * y + CUBIC / 3.0 * near**3 + CUBIC * ON_TREAD**2 * (y - near)
    root = float(np.interp(ROOT, y, flange)) + float(np.interp(ROOT, y, fall))
    z = np.where(y > ROOT, root - fall, flange)
    rows = "\n".join(f"{a + 70:.4f} {b:.6f}" for a, b in zip(y, z, strict=True))
    return f"ProgramName=MiniProf\nXYPoints={len(y)}\nColumnDef=X,Y\n\n{rows}\n"


HEADER = (
    "wheels", "track", "estimator", "wheelsets with a conicity", "error, median", "error, 95th percentile",
    "own covariance covers", "real-time factor", "state, kB",
)  # fmt: skip
NEAR = 3  # amplitudes 1.0, 1.25 and 1.5 mm come first
REACH_NEAR, REACH_SPEED, FOLLOWS = 0.01, 1000.0, 0.01
DEFAULT, OF_TODAY = "bins", "hidden"
NEAR_TEXT = (
    "Next to contact jumps (P8/113A, 1.0 to 1.5 mm). The simulator's contact tables have points every {:g} mm here, so "
    "that jumps are where the profiles have them. 'As run' is against that table; its conicity is itself off by {:.4f} "
    "(95th percentile) from that of the profiles."
)


def _chosen(found: Sequence[Case], **wanted: str) -> list[Case]:
    return [one for one in found if all(one[key] == value for key, value in wanted.items())]


def _errors(found: Sequence[Case], key: str = "errors", near: bool = False) -> np.ndarray[Any, Any]:  # noqa: FBT001, FBT002 - of this file
    every = [error for one in found for error in (one[key][:NEAR] if near else one[key])]
    return np.abs(np.array([error for error in every if error is not None], dtype=np.float64))


def _share(found: Sequence[Case], key: str) -> str:
    every = [inside for one in found for inside in one[key]]
    return f"{100 * sum(every) / len(every):.0f} % of {len(every)}" if every else ""


def table_rows(found: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return the rows of the table: fleet, track and estimator in the order in which they were run."""
    keys = list(dict.fromkeys((one["family"], one["track"], one["estimator"]) for one in found))
    rows = []
    for family, track, estimator in keys:
        of = _chosen(found, family=family, track=track, estimator=estimator)
        errors = _errors(of)
        given = sum(any(error is not None for error in one["errors"]) for one in of)
        codes = sorted({one["reason"] for one in of if one["reason"]})
        shown = f"{given} of {len(of)}" + (f" ({', '.join(codes)})" if codes else "")
        quantiles = [f"{np.quantile(errors, level):.4f}" if len(errors) else "" for level in (0.5, 0.95)]
        speed = sum(one["running_s"] for one in of) / max(sum(one["cpu_s"] for one in of), 1e-9)
        size = f"{np.median([one['state_bytes'] for one in of]) / 1e3:.0f}"
        rows.append((family, track, estimator, shown, *quantiles, _share(of, "own_covered"), f"{speed:.0f}", size))
    return rows


def near_rows(found: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return what comes out next to contact jumps, 1.0 to 1.5 mm: against profiles and against what was run on."""
    rows = []
    jumps = _chosen(found, family=JUMPS)
    for track, estimator in dict.fromkeys((one["track"], one["estimator"]) for one in jumps):
        of = _chosen(jumps, track=track, estimator=estimator)
        cells = [track, estimator]
        for key in ("errors", "errors_as_run"):
            errors = _errors(of, key, near=True)
            cells += [f"{np.quantile(errors, level):.4f}" if len(errors) else "" for level in (0.5, 0.95)]
        rows.append(tuple(cells))
    return rows


def floor(found: Sequence[Case]) -> float:
    """Return the 95th percentile, next to jumps, of what the simulator's table changes of the conicity."""
    jumps = _chosen(found, family=JUMPS, track="known", estimator=DEFAULT)
    apart = [
        abs(a - b)
        for one in jumps
        for a, b in zip(one["errors"][:NEAR], one["errors_as_run"][:NEAR], strict=True)
        if a is not None
    ]
    return float(np.quantile(apart, 0.95)) if apart else float("nan")


def bench_rows(found: Sequence[Case]) -> Iterator[BenchRow]:
    """Yield what was to be reached."""
    known = _chosen(found, family=JUMPS, track="known")
    for estimator in (DEFAULT, OF_TODAY):
        of = _chosen(known, estimator=estimator)
        for key, words in (("errors", "the profiles"), ("errors_as_run", "the table that was run on")):
            errors = _errors(of, key, near=True)
            if len(errors):
                p95 = float(np.quantile(errors, 0.95))
                what = f"{estimator}, next to contact jumps, known track, against {words}: 95th percentile"
                yield BenchRow(what, f"{p95:.4f}", f"{REACH_NEAR}", p95 <= REACH_NEAR)
    smooth = _chosen(found, family=SMOOTH, track="known")
    for estimator in ("extended_kalman", "cubic", OF_TODAY):
        errors = _errors(_chosen(smooth, estimator=estimator))
        if len(errors):
            median = float(np.median(errors))
            what = f"{estimator} on smooth wheels, known track: median error"
            yield BenchRow(what, f"{median:.4f}", f"{FOLLOWS}", median <= FOLLOWS)
    for estimator in ("extended_kalman", "particles", OF_TODAY):
        of = _chosen(found, estimator=estimator)
        if of:
            speed = sum(one["running_s"] for one in of) / max(sum(one["cpu_s"] for one in of), 1e-9)
            what = f"{estimator}: real-time factor per wheelset and core"
            yield BenchRow(what, f"{speed:.0f}", f"{REACH_SPEED:.0f}", speed >= REACH_SPEED)


def parts(found: Sequence[Case]) -> list[Part]:
    """Return the page of results."""
    seeds = sorted({(one["family"], one["seed"]) for one in found})
    listed = "; ".join(f"{name}: {', '.join(str(s) for f, s in seeds if f == name)}" for name in dict(seeds))
    near = ("track", "estimator", "profiles, median", "95th percentile", "as run, median", "95th percentile")
    return [
        f"Seeds: {listed}. Errors are of the equivalent conicity at 1.0 to 3.0 mm, against the profiles.",
        ResultTable(HEADER, table_rows(found), range(4, 9)),
        figures_table("Published numbers against the truth", _clusters(found)),
        NEAR_TEXT.format(1e3 * STEP, floor(found)),
        ResultTable(near, near_rows(found), range(2, 6)),
        row_table(bench_rows(found)),
    ]


def _clusters(found: Sequence[Case]) -> Iterator[tuple[str, list[Cluster]]]:
    """Yield the numbers of each row of the table by fleet."""
    for family, track, estimator in dict.fromkeys((one["family"], one["track"], one["estimator"]) for one in found):
        of = _chosen(found, family=family, track=track, estimator=estimator)
        fleets = [[one for one in of if one["seed"] == seed] for seed in dict.fromkeys(one["seed"] for one in of)]
        yield f"{family}, {track}, {estimator}", [_cluster(fleet) for fleet in fleets]


def _cluster(fleet: Sequence[Case]) -> Cluster:
    numbers = [number for one in fleet for number in one["compared"]]
    withheld = [one["reason"] for one in fleet for number in one["compared"] if number is None]
    return Cluster.read([number for number in numbers if number is not None], withheld)


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case]:
    for seed, family in product(options.seeds, options.families):
        tracks = [track for track in options.tracks if (family, seed, track) not in done]
        if not tracks:
            continue
        with tempfile.TemporaryDirectory(prefix="treadwatch-rivals-") as name:
            scenario = fleet(family, seed, options.vehicles, Path(name) / "wheels")
            made = list(scores(scenario, family, [TrackInformation(track) for track in tracks], Path(name)))
        for track in tracks:
            of_track = [asdict(one) for one in made if one.track == track]
            yield {"family": family, "seed": seed, "track": track, "scores": of_track}


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--families", type=one_of(FAMILIES), default=list(FAMILIES), help=", ".join(FAMILIES))
    tracks = [str(track.value) for track in TrackInformation]
    parser.add_argument("--tracks", type=one_of(tracks), default=tracks, help=", ".join(tracks))
    parser.add_argument("--vehicles", type=int, default=4, help="of four wheelsets (4)")


main = Study(
    name="rivals",
    title="Rival estimators",
    about=__doc__ or "",
    cases=_cases,
    parts=lambda cases: parts([one for case in cases for one in case["scores"]]),
    line=lambda case: f"{case['family']} seed {case['seed']}, track {case['track']}: done",
    seeds="0-19",
    key=("family", "seed", "track"),
    options=_options,
).run
