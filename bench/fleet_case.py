"""A scenario through the product: what is published of its wheelsets and its section, and why not, against the truth.

Band-limited signals carry no offset. Bins are therefore compared with the true curve counted from the place on it that
fits them best, and less its mean over the samples (R and D). The place is between the track centre and the true zero
crossing, or within 0.6 mm of either; it is not scored, and the zero crossing is published as unknown. Conicity and NP
do not depend on it.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from api.comparison.study import TrueWheelset, read_truth
from api.comparison.trial import ESTIMATION, deploy, opened, receive, record, run_jobs
from bench.conicities import Conicities
from bench.scores import AMPLITUDES, compared, compared_at, withheld_at
from bench.study import Case, Key, in_processes
from estimation.accuracy.fleet_accuracy import curve_origin
from estimation.filters import high_pass, local_cubic_kernel
from estimation.motion.window_motion import deconvolved
from estimation.storage import Storage, UnitOfWork
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.geometry import BinStatus, BinValues, WheelsetGeometry
from estimation.values.quantities import Estimate, Status
from estimation.values.track import AlignmentSource, TrackAlignment
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
    published: int  # places
    covered: int  # of these, by the 95 % interval
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
        published=int(inner.sum()),
        covered=int(inside.sum()),
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


SECONDS_PER_HOUR = 3600.0


def scored(scenario: Scenario, cache: Path | None = None) -> dict[str, Any]:
    """Return the score of a scenario in a folder of its own; recordings stay in ``cache`` where it is given."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-bench-") as name:
        folder = Path(name)
        return score(scenario, cache or folder / "recordings", folder / "data")


def score(scenario: Scenario, cache: Path, folder: Path) -> dict[str, Any]:
    """Run a scenario through the product, in an empty folder, and compare what is published with the truth.

    Nothing is left out and nothing is set: recordings go through the receiver, windows are examined and screened,
    passes become epochs, and the uncertainty of the vehicle parameters is as shipped.
    """
    recorded = record(scenario, cache, workers=1)
    truths = read_truth(recorded.truth)
    began = time.perf_counter()
    settings = deploy(scenario, folder)
    receive(recorded, settings)
    with opened(settings) as (storage, context):
        clock = [time.process_time()]
        for job in ESTIMATION:
            run_jobs(context, [job])
            clock.append(time.process_time())
        stored = _stored(storage, scenario, truths)
    sessions = scenario.sessions
    return stored | {
        "row": scenario.name,
        "pair": scenario.pair,
        "seed": scenario.seed,
        "drawn": scenario.vehicle_errors is not None,
        "cpu_s": [after - before for before, after in pairwise(clock)],  # of alignment, windows, geometry
        "wheelset_hours": len(truths) * sessions.campaigns * sessions.duration / SECONDS_PER_HOUR,
        "seconds": time.perf_counter() - began,  # ingest and jobs by the clock
    }


def _stored(storage: Storage, scenario: Scenario, truths: Sequence[TrueWheelset]) -> dict[str, Any]:
    section = scenario.section.code
    wheelsets: list[dict[str, Any]] = []
    with storage.read() as unit:
        verdicts = [_verdict(unit, truth.serial) for truth in truths]
        for truth in truths:
            current = unit.geometries.current(truth.serial)
            if current is not None and current.geometry.samples.sum() > 0:
                wheelsets.append(_wheelset_score(current.geometry, truth))
        alignment, report = unit.tracks.alignment(section), unit.tracks.report(section)
        windows = {str(state): count for state, count in unit.windows.counts().items()}
    known = alignment is not None and bool(np.isfinite(alignment.alignment).any())
    fleet = alignment is not None and known and alignment.source == AlignmentSource.FLEET
    reported = {} if report is None else report.report
    diversity = reported.get("diversity")
    return {
        "wheelsets": wheelsets,
        "verdicts": verdicts,
        "windows": windows,
        "survey": str(reported.get("recording_code") or ""),  # verdict on it
        "reason": "" if report is None or report.reason is None else str(report.reason),  # why there is no alignment
        "status": "estimated" if fleet else "recorded" if known else "unestimated",
        "alignment": asdict(alignment_score(scenario, alignment)) if fleet and alignment is not None else None,
        "diversity": diversity if isinstance(diversity, float) else 0.0,  # of the last epoch; 0: nothing was solved
    }


def _verdict(unit: UnitOfWork, serial: str) -> dict[str, Any]:
    """Return status and reason of a wheelset: of its geometry, else of most of its refused windows."""
    current, codes = unit.geometries.current(serial), _window_codes(unit, serial)
    of_windows = codes.most_common(1)[0][0] if codes else ""
    if current is None:
        return {"serial": serial, "status": str(Status.UNESTIMATED), "code": of_windows, "published": False}
    geometry = current.geometry
    published = any(one.value is not None for one in geometry.conicity)
    reason = geometry.reason or (None if published else geometry.equivalent_conicity.reason)
    code = "" if reason is None else reason.code
    code = code or ("" if published else of_windows)
    return {"serial": serial, "status": str(geometry.status), "code": code, "published": published}


def _window_codes(unit: UnitOfWork, serial: str) -> Counter[str]:
    return Counter(window.reason.code for window in unit.windows.list(serial) if window.reason is not None)


def _wheelset_score(found: WheelsetGeometry, truth: TrueWheelset) -> dict[str, Any]:
    """Return how near a geometry comes: errors of the conicity, and how many intervals cover of how many, by kind."""
    true = np.interp(AMPLITUDES, truth.amplitude, truth.conicity)
    conicities = compared_at(AMPLITUDES, true, found.amplitude, found.conicity)
    published = [one for one in conicities if one is not None]
    given = [one.error for one in published]
    origin = curve_origin(found, truth.displacement, truth.difference, truth.zero_crossing)
    x = found.bin_centres + origin.displacement
    differences = np.interp(x, truth.displacement, truth.angle_difference)
    unknown = float(found.samples @ differences / found.samples.sum())  # lost with the means, like that of R
    radius_difference = np.interp(x, truth.displacement, truth.difference) - origin.difference
    return {
        "serial": truth.serial,
        "error": float(np.mean(np.abs(given))) if given else None,  # over the amplitudes estimated
        "signed": float(np.mean(given)) if given else None,
        "asked": len(conicities),
        "compared": conicities,  # by amplitude
        "withheld": withheld_at(AMPLITUDES, found.amplitude, found.conicity),
        "conicity": _counted([one.covered for one in published]),
        "difference": _counted(_bins(found.rolling_radius_difference, radius_difference)),
        "other_bins": _counted(  # by the criterion of the geometry S and A are not published
            [
                *_bins(found.rolling_radius_sum, np.interp(x, truth.displacement, truth.radius_sum)),
                *_bins(found.contact_angle_sum, np.interp(x, truth.displacement, truth.angle_sum)),
                *_bins(found.contact_angle_difference, differences - unknown),
            ]
        ),
        "nonlinearity": _covers(found.nonlinearity, truth.nonlinearity),
        "zero_crossing": _covers(found.zero_crossing, truth.zero_crossing),
    }


def _counted(inside: Sequence[bool]) -> dict[str, int]:
    return {"published": len(inside), "covered": sum(inside)}


def _bins(values: BinValues, truth: FloatArray) -> list[bool]:
    known = np.array([status is BinStatus.ESTIMATED for status in values.status])
    inside: list[bool] = (np.abs(values.value[known] - truth[known]) <= NORMAL_95 * values.std[known]).tolist()
    return inside


def _covers(estimate: Estimate, truth: float) -> dict[str, int]:
    found = compared(estimate, truth)
    return _counted([] if found is None else [found.covered])


def summary_line(case: Case) -> str:
    """Return a case in a line."""
    figures, statuses = Conicities.of([case]), Counter(verdict["status"] for verdict in case["verdicts"])
    codes = sorted({verdict["code"] for verdict in case["verdicts"] if verdict["code"]})
    line = f"{case['row']}{' with parameter errors' if case['drawn'] else ''} seed {case['seed']}, {case['pair']}: "
    line += f"error {figures.error}, {figures.cover} of {figures.published} cover, {dict(statuses)}, "
    if case["alignment"] is not None:
        line += f"alignment {1e3 * case['alignment']['band']:.3f} mm, "
    line += f"{', '.join(codes) or 'no reason'}, {case['survey'] or 'no survey'}, "
    cost = sum(case["cpu_s"]) / case["wheelset_hours"]
    return f"{line}{cost:.1f} s/h, {case['seconds']:.0f} s {case['reason'][:60]}"


def fleet_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a study of fleets."""
    parser.add_argument("--workers", type=int, default=2, help="processes")


def cases_of(
    work: Callable[..., Case], options: argparse.Namespace, done: Collection[Key], rows: Sequence[str]
) -> Iterator[Case | None]:
    """Yield what ``work`` returns for each row and seed that is not done."""
    tasks = [(row, seed) for seed in options.seeds for row in rows if (row, seed) not in done]
    yield from in_processes(work, tasks, options.workers)
