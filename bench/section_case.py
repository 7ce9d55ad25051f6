"""One row of the accuracy table for one seed: the product's numerics, held against the truth.

Windows become passes, passes an alignment with positions, windows and alignment bin tables, these a geometry, by the
functions that the jobs call. What the jobs do besides is left out:

- Windows are not examined or screened against each other before they become passes; these are all honest.
- Windows that follow each other become one pass however many they are; the job joins four.
- All passes are one epoch, so no alignment is evidence for the next one. All windows of a wheelset are merged alike.
- No layout is on file, and nothing goes through the bus, a store or the REST API.

Where no parameter errors are drawn, the ratio of yaw stiffness to creep is taken as known unless the fleet has told it:
of the uncertainty as shipped masses and spin creep are left. Where they are drawn it is as shipped.

Band-limited signals carry no offset. Bins are therefore held against the true curve seen from the place on it that
fits them best, within 0.6 mm of the true zero crossing, and less its mean over the samples (R and D): where on the true
curve they lie is not scored, and the zero crossing is published as unknown. Conicity and NP do not depend on it.

Everything that is counted or measured is returned as plain numbers.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, replace

import numpy as np

from bench.section_alignment import AlignmentScore, alignment_score
from estimation.estimators.tracks import TrackKnowledge, fleet_knowledge, section_passes
from estimation.geometry.estimate import estimate_geometry
from estimation.jobs.settings import EstimationSettings
from estimation.tables import bin_table
from estimation.tables.window import tabulate_window
from estimation.track.settings import AlignmentSettings
from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinStatus, BinValues, WheelsetGeometry
from estimation.values.intervals import NORMAL_95
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason
from ingest.simulator.section_run import SECTION, SectionRun, WheelsetTruth

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
    stds: tuple[float | None, ...]
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
    alignment: AlignmentScore | None
    status: str  # of the alignment; "recorded" where it was known
    reason: str
    seconds: tuple[float, float, float]  # passes, alignment, forward: processor time

    def as_json(self) -> dict[str, object]:
        """Return everything as JSON values."""
        return asdict(self)


def score(run: SectionRun) -> CaseScore:
    """Run the product's numerics on ``run`` and compare."""
    settings, alignment = EstimationSettings(), AlignmentSettings()
    scenario = run.scenario
    clock = [time.process_time()]
    known = run.known_track()
    moved = bool(scenario.position_offset or scenario.position_scale)
    if known is not None and not moved:
        knowledge: TrackKnowledge | str = TrackKnowledge(known)
        clock += [clock[0], clock[0]]
    else:
        found = section_passes(run.all_windows(), settings.windows, alignment)
        clock.append(time.process_time())
        evidence = known if known is not None else run.known_gauge()
        knowledge = fleet_knowledge(found, evidence, SECTION, scenario.length, alignment, run.measured())
        clock.append(time.process_time())
    if isinstance(knowledge, str):
        geometries: dict[str, WheelsetGeometry] = {}
    else:
        geometries = {truth.serial: _geometry(run, truth, knowledge, settings) for truth in run.wheelsets}
    clock.append(time.process_time())
    told = None if isinstance(knowledge, str) or knowledge.found is None else knowledge.found
    return CaseScore(
        row=scenario.name,
        pair=run.pair.name,
        seed=run.seed,
        drawn=scenario.errors_drawn,
        wheelsets=tuple(
            wheelset_score(geometries[truth.serial], truth) for truth in run.wheelsets if truth.serial in geometries
        ),
        alignment=alignment_score(run, told.alignment) if told is not None and told.alignment is not None else None,
        status="unestimated" if isinstance(knowledge, str) else "recorded" if told is None else told.report.status,
        reason=knowledge if isinstance(knowledge, str) else "",
        seconds=(clock[1] - clock[0], clock[2] - clock[1], clock[3] - clock[2]),
    )


def _geometry(
    run: SectionRun, truth: WheelsetTruth, knowledge: TrackKnowledge, settings: EstimationSettings
) -> WheelsetGeometry:
    tables = []
    for window in run.windows(truth.serial):
        correction = knowledge.correction_of(window)
        if correction is None:
            continue
        table = tabulate_window(window, knowledge.track, settings.windows, correction)
        if not isinstance(table, Reason):
            tables.append(table)
    assumed = settings.geometry.uncertainty
    assumed = assumed if run.scenario.errors_drawn else replace(assumed, ratio=0.0)
    shape = replace(settings.geometry, uncertainty=assumed.on([knowledge.track]))
    return estimate_geometry(bin_table.merge_all(tables, settings.bins), settings.bins, shape)


def wheelset_score(found: WheelsetGeometry, truth: WheelsetTruth) -> WheelsetScore:
    """Return how near ``found`` is to ``truth``."""
    errors: list[float | None] = []
    stds: list[float | None] = []
    conicity = Count()
    for amplitude, true in zip(truth.amplitude, truth.conicity, strict=True):
        at = int(np.argmin(np.abs(found.amplitude - amplitude)))
        estimate = found.conicity[at]
        known = estimate.value is not None and bool(np.isclose(found.amplitude[at], amplitude, rtol=0, atol=1e-9))
        errors.append(estimate.value - float(true) if known and estimate.value is not None else None)
        stds.append(estimate.std if known else None)
        conicity = _counted(conicity, estimate, float(true)) if known else conicity
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
        stds=tuple(stds),
        conicity=conicity,
        difference=Count(
            *_bins(found.rolling_radius_difference, np.interp(x, truth.displacement, truth.difference) - mean)
        ),
        other_bins=others,
        nonlinearity=_counted(Count(), found.nonlinearity, truth.nonlinearity),
        zero_crossing=_counted(Count(), found.zero_crossing, truth.zero_crossing),
    )


def origin(found: WheelsetGeometry, truth: WheelsetTruth) -> tuple[float, float]:
    """Return (y - d, R) of the true curve, m, from which the estimated one is counted.

    Band-limited signals have lost their means, so the estimated curve has its origin at the mean of both: it may lie
    anywhere along the true curve, with its own R on average nought. The place where it fits best is taken.
    """
    centre, R = found.bin_centres, found.rolling_radius_difference
    known = np.isfinite(R.value)
    if not known.any():
        return truth.zero_crossing, 0.0
    best = (np.inf, truth.zero_crossing, 0.0)
    for shift in truth.zero_crossing + np.linspace(-SEARCHED, SEARCHED, 241):
        curve = np.interp(centre + shift, truth.displacement, truth.difference)
        mean = float(found.samples @ curve / found.samples.sum())
        strayed = (R.value - curve + mean)[known] / R.std[known]
        misfit = float(np.minimum(strayed**2, 9.0).sum())
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
