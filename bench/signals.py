"""Cut-offs of the high-pass compared on truth: errors of the signals, and the conicity that comes of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.report import BenchRow
from bench.signal_cases import AMPLITUDES, COURSES, Run, simulate, wheelsets
from estimation.filters import remove_wander
from estimation.geometry.estimate import estimate_geometry
from estimation.jobs.settings import EstimationSettings
from estimation.motion.checks import usable_samples
from estimation.motion.integration import SignalParameters, integrate
from estimation.motion.window_motion import motion
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters
from estimation.values.arrays import FloatArray
from estimation.values.geometry import WheelsetGeometry
from estimation.values.reasons import Reason
from estimation.values.windows import Motion
from estimation.vehicle.regressors import regression
from estimation.vehicle.vehicle_class import VehicleParameters

SEEDS = (1, 2)
SHIPPED = SignalParameters()
DESIGNS: Mapping[str, SignalParameters] = {
    "smoother 60 m": replace(SHIPPED, cutoff_wavelength=60.0),
    "smoother 40 m": SHIPPED,
    "smoother 30 m": replace(SHIPPED, cutoff_wavelength=30.0),
}
IN_FORCE, LONGER = "smoother 40 m", "smoother 60 m"
ALL = "all"
NO_LAYOUT = "curves, no layout on file"


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one design made of one run."""

    course: str
    wheelset: str
    design: str
    error: FloatArray  # (4,) rms of y - d (m), psi (rad), psi' (rad/s), rL - rR (m)
    used: float  # share of the samples
    conicity_error: float  # mean absolute, over the amplitudes covered
    bias: float  # relative
    covered: tuple[bool, ...]


def rows() -> Iterator[BenchRow]:
    """Print the table of all designs and yield what the one in force must keep."""
    with ProcessPoolExecutor(2) as pool:
        tasks = [(number, course, seed) for course in COURSES for number in range(len(wheelsets())) for seed in SEEDS]
        found = [item for group in pool.map(_outcomes, tasks) for item in group]
    courses = tuple(dict.fromkeys(item.course for item in found))
    Console(width=150).print(*(_table(found, course) for course in courses), sep="\n")
    for course in courses:
        ours, longer = (_errors(found, course, design) for design in (IN_FORCE, LONGER))
        cover = np.mean([c for item in found if (item.course, item.design) == (course, IN_FORCE) for c in item.covered])
        yield BenchRow(
            f"signals, {course}: equivalent conicity, error over 1-3 mm, mean of {len(ours)} runs",
            f"{ours.mean():.4f} ({IN_FORCE}; {LONGER}: {longer.mean():.4f}); {100 * cover:.0f} % of intervals cover",
            f"less than {LONGER}",
            bool(ours.mean() <= longer.mean()),
        )


def _errors(found: Sequence[Outcome], course: str, design: str) -> FloatArray:
    return np.array([item.conicity_error for item in found if (item.course, item.design) == (course, design)])


def _table(found: Sequence[Outcome], course: str) -> Table:
    table = Table(title=course, title_justify="left")
    for name in (
        "wheelset",
        "design",
        "y-d mm",
        "psi mrad",
        "psi' mrad/s",
        "R mm",
        "used",
        "conicity",
        "bias",
        "cover",
    ):
        table.add_column(name, justify="left" if name in {"wheelset", "design"} else "right")
    for name in (*(wheelset.name for wheelset in wheelsets()), ALL):
        for design in DESIGNS:
            here = [i for i in found if (i.course, i.design) == (course, design) and name in {i.wheelset, ALL}]
            y, psi, rate, difference = np.sqrt(np.mean([item.error**2 for item in here], axis=0))
            covered = [c for item in here for c in item.covered]
            table.add_row(
                name,
                design,
                f"{1e3 * y:.3f}",
                f"{1e3 * psi:.3f}",
                f"{1e3 * rate:.2f}",
                f"{1e3 * difference:.3f}",
                f"{np.mean([item.used for item in here]):.0%}",
                f"{np.mean([item.conicity_error for item in here]):.4f}",
                f"{np.mean([item.bias for item in here]):+.1%}",
                f"{np.mean(covered):.0%}" if covered else "",
            )
        table.add_section()
    return table


def _outcomes(task: tuple[int, str, int]) -> list[Outcome]:
    number, course, seed = task
    run = simulate(wheelsets()[number], course, seed)
    one = partial(_outcome, run)
    found = [one(course, design, parameters) for design, parameters in DESIGNS.items()]
    if run.layout is not None:
        blind = replace(run, layout=None)
        found += [_outcome(blind, NO_LAYOUT, design, parameters) for design, parameters in DESIGNS.items()]
    return found


def _outcome(run: Run, course: str, design: str, parameters: SignalParameters) -> Outcome:
    settings = EstimationSettings(signals=parameters)
    bins = BinParameters(source=parameters.source, band_limited=True)
    tables, squares, used = [], [], 0
    for number in range(len(run.windows)):
        moved = motion(run.windows[number], run.track, parameters, run.layout)
        if isinstance(moved, Reason):
            continue
        tables.append(bin_table.tabulate(moved, bins))
        squares.append(np.square(_measured(moved) - _true(run, number, parameters))[:, moved.valid])
        used += int(moved.valid.sum())
    error = np.sqrt(np.mean(np.concatenate(squares, axis=1), axis=1))
    found = estimate_geometry(bin_table.merge_all(tables, bins), bins, settings.geometry)
    total = sum(len(window.valid) for window in run.windows)
    return Outcome(course, run.wheelset, design, error, used / total, *score(found, run.conicity))


def _measured(moved: Motion) -> FloatArray:
    """Return y - d, psi, psi' and rL - rR (4, n); of the last the small part of the contact angles is left out."""
    equations = regression(moved, VehicleParameters())
    difference = equations.yaw_targets[:, 0] / equations.yaw[:, 1]
    return np.stack([moved.displacement, moved.yaw, moved.yaw_rate, difference])


def _true(run: Run, number: int, parameters: SignalParameters) -> FloatArray:
    """Return the same of the truth (4, n), behind the same filter."""
    window, true = run.windows[number], run.truth(number)
    everywhere = np.ones(len(window.valid), dtype=np.bool_)
    usable = usable_samples(window, everywhere, run.layout, parameters).samples
    gap = round(parameters.modelled_gap_s / window.sample_interval_s)
    result = np.full(true.shape, np.nan)
    for segment in integrate(window, usable, parameters, gap).segments:
        result[:, segment.part] = remove_wander(
            true[:, segment.part],
            segment.run,
            segment.known,
            parameters.cutoff_wavelength,
            parameters.bridged_samples,
        )
    return result


def score(found: WheelsetGeometry, conicity: FloatArray) -> tuple[float, float, tuple[bool, ...]]:
    """Return mean absolute error, mean relative error, and which intervals cover ``conicity`` at ``AMPLITUDES``."""
    errors, bias, covered = [], [], []
    for amplitude, estimate in zip(found.amplitude, found.conicity, strict=True):
        at = np.flatnonzero(np.isclose(AMPLITUDES, amplitude))
        if not len(at) or estimate.value is None or estimate.low is None or estimate.high is None:
            continue
        true = float(conicity[at[0]])
        errors.append(abs(estimate.value - true))
        bias.append(estimate.value / true - 1)
        covered.append(bool(estimate.low <= true <= estimate.high))
    if not errors:
        return float("nan"), float("nan"), ()
    return float(np.mean(errors)), float(np.mean(bias)), tuple(covered)
