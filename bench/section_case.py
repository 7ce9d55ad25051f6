"""One row of the accuracy table for one seed: simulate, ingest, jobs, stored geometries against truth.

Nothing is left out and nothing is set: recordings go through the receiver, windows are examined and screened, passes
become epochs, and the uncertainty of the vehicle parameters is as shipped.

Band-limited signals carry no offset. Bins are therefore compared with the true curve counted from the place on it that
fits them best, within 0.6 mm of the true zero crossing, and less its mean over the samples (R and D): where on the true
curve they lie is not scored, and the zero crossing is published as unknown. Conicity and NP do not depend on it.

Everything that is counted or measured is returned as plain numbers.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from api.comparison.trial import ESTIMATION, deploy, opened, receive, record, run_jobs
from api.comparison.truth import TrueWheelset, conicity_errors, read_truth
from bench.section_alignment import AlignmentScore, alignment_score
from estimation.storage import Storage
from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinStatus, BinValues, WheelsetGeometry
from estimation.values.intervals import NORMAL_95
from estimation.values.quantities import Estimate
from estimation.values.track import AlignmentSource
from ingest.simulator.scenario import Scenario

SEARCHED = 0.6e-3  # m


@dataclass(frozen=True, slots=True)
class Count:
    """Published numbers of a kind, and those whose 95 % interval holds the truth."""

    published: int = 0
    covered: int = 0

    def plus(self, published: int, covered: int) -> Count:
        """Return the sum."""
        return Count(self.published + published, self.covered + covered)


@dataclass(frozen=True, slots=True)
class WheelsetScore:
    """How near the geometry of one wheelset came."""

    serial: str
    error: float | None  # mean absolute error of the conicity over the amplitudes estimated; None without any
    signed: float | None  # mean error
    amplitudes: tuple[float | None, ...]  # error at each amplitude asked for
    conicity: Count
    difference: Count  # R per bin
    other_bins: Count  # S, A and D per bin; by the criterion of the geometry S and A are not published
    nonlinearity: Count
    zero_crossing: Count


@dataclass(frozen=True, slots=True)
class CaseScore:
    """One row, one seed."""

    row: str
    pair: str
    seed: int
    drawn: bool
    wheelsets: tuple[WheelsetScore, ...]
    windows: Mapping[str, int]  # by state
    reasons: Mapping[str, int]  # codes of the windows that were refused
    alignment: AlignmentScore | None  # of the fleet's own
    status: str  # of the alignment; "recorded" where a survey is in force
    reason: str
    seconds: tuple[float, float, float]  # alignment job, windows job, geometry job: processor time
    all_seconds: float  # ingest and jobs, wall clock

    def as_json(self) -> dict[str, object]:
        """Return everything as JSON values."""
        return asdict(self)


def score(scenario: Scenario, cache: Path, folder: Path) -> CaseScore:
    """Run a scenario through the product and compare what is stored with the truth.

    Parameters
    ----------
    scenario
        The row, with its seed.
    cache
        Folder that keeps recordings.
    folder
        Where the deployment keeps its data; empty.
    """
    recorded = record(scenario, cache, workers=1)
    began = time.perf_counter()
    settings = deploy(scenario, folder)
    receive(recorded, settings)
    clock = [time.process_time()]
    with opened(settings) as (storage, context):
        for job in ESTIMATION:
            run_jobs(context, [job])
            clock.append(time.process_time())
        found = _stored(storage, scenario, recorded.truth)
    return CaseScore(
        row=scenario.name,
        pair=scenario.pair,
        seed=scenario.seed,
        drawn=scenario.vehicle_errors is not None,
        wheelsets=found.wheelsets,
        windows=found.windows,
        reasons=found.reasons,
        alignment=found.alignment,
        status=found.status,
        reason=found.reason,
        seconds=(clock[1] - clock[0], clock[2] - clock[1], clock[3] - clock[2]),
        all_seconds=time.perf_counter() - began,
    )


@dataclass(frozen=True, slots=True)
class _Stored:
    """What the store holds after the jobs."""

    wheelsets: tuple[WheelsetScore, ...]
    windows: Mapping[str, int]
    reasons: Mapping[str, int]
    alignment: AlignmentScore | None
    status: str
    reason: str


def _stored(storage: Storage, scenario: Scenario, truth_file: Path) -> _Stored:
    wheelsets, reasons = [], dict[str, int]()
    with storage.read() as unit:
        for truth in read_truth(truth_file):
            for window in unit.windows.list(truth.serial):
                if window.reason is not None:
                    reasons[window.reason.code] = reasons.get(window.reason.code, 0) + 1
            current = unit.geometries.current(truth.serial)
            if current is not None and current.geometry.samples.sum() > 0:
                wheelsets.append(wheelset_score(current.geometry, truth))
        section = scenario.section.code
        alignment, report = unit.tracks.alignment(section), unit.tracks.report(section)
        windows = {str(state): count for state, count in unit.windows.counts().items()}
    known = alignment is not None and bool(np.isfinite(alignment.alignment).any())
    fleet = known and alignment is not None and alignment.source == AlignmentSource.FLEET
    return _Stored(
        wheelsets=tuple(wheelsets),
        windows=windows,
        reasons=reasons,
        alignment=alignment_score(scenario, alignment) if fleet and alignment is not None else None,
        status="estimated" if fleet else "recorded" if known else "unestimated",
        reason="" if known else "no alignment" if report is None else str(report.report.get("reason", "")),
    )


def wheelset_score(found: WheelsetGeometry, truth: TrueWheelset) -> WheelsetScore:
    """Return how near ``found`` is to ``truth``."""
    compared = conicity_errors(found, truth)
    errors = [None if item is None else item[0] for item in compared]
    inside = [item[1] for item in compared if item is not None]
    conicity = Count(len(inside), sum(inside))
    given = [error for error in errors if error is not None]
    centre = found.bin_centres
    shift, mean = origin(found, truth)
    x = centre + shift
    others = Count()
    differences = np.interp(x, truth.displacement, truth.angle_difference)
    unknown = float(found.samples @ differences / found.samples.sum())  # lost with the means, like that of R
    for values, true_values in (
        (found.rolling_radius_sum, np.interp(x, truth.displacement, truth.radius_sum)),
        (found.contact_angle_sum, np.interp(x, truth.displacement, truth.angle_sum)),
        (found.contact_angle_difference, differences - unknown),
    ):
        others = others.plus(*_bins(values, true_values))
    return WheelsetScore(
        serial=truth.serial,
        error=float(np.mean(np.abs(given))) if given else None,
        signed=float(np.mean(given)) if given else None,
        amplitudes=tuple(errors),
        conicity=conicity,
        difference=Count(
            *_bins(found.rolling_radius_difference, np.interp(x, truth.displacement, truth.difference) - mean)
        ),
        other_bins=others,
        nonlinearity=_counted(Count(), found.nonlinearity, truth.nonlinearity),
        zero_crossing=_counted(Count(), found.zero_crossing, truth.zero_crossing),
    )


def origin(found: WheelsetGeometry, truth: TrueWheelset) -> tuple[float, float]:
    """Return (y - d, R) of the true curve, m, from which the estimated one is counted.

    Band-limited signals have lost their means, so the estimated curve has its origin at the mean of both: it may lie
    anywhere along the true curve, with its own R zero on average. The place where it fits best is taken.
    """
    centre, R = found.bin_centres, found.rolling_radius_difference
    known = np.isfinite(R.value)
    if not known.any():
        return truth.zero_crossing, 0.0
    best = (np.inf, truth.zero_crossing, 0.0)
    for shift in truth.zero_crossing + np.linspace(-SEARCHED, SEARCHED, 241):
        curve = np.interp(centre + shift, truth.displacement, truth.difference)
        mean = float(found.samples @ curve / found.samples.sum())
        deviation = (R.value - curve + mean)[known] / R.std[known]
        misfit = float(np.minimum(deviation**2, 9.0).sum())
        best = min(best, (misfit, float(shift), mean))
    return best[1], best[2]


def _bins(values: BinValues, truth: FloatArray) -> tuple[int, int]:
    known = np.array([status is BinStatus.ESTIMATED for status in values.status])
    inside = np.abs(values.value[known] - truth[known]) <= NORMAL_95 * values.std[known]
    return int(known.sum()), int(inside.sum())


def _counted(count: Count, estimate: Estimate, truth: float) -> Count:
    if estimate.value is None or estimate.low is None or estimate.high is None or not np.isfinite(truth):
        return count
    return count.plus(1, int(estimate.low <= truth <= estimate.high))
