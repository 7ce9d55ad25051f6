"""The numbers that docs/decisions quotes. Run: ``python -m bench.decisions [DEMO_FOLDER] [--write-docs]``.

The scenario is ``mems`` (four wheelsets, ten minutes, MEMS sensors), of three seeds, through recordings, receiver and
windows. With a folder of ``treadwatch demo`` the forgetting is measured on its fleet too. ``--write-docs`` writes what
is printed to ``docs/results/decisions.md`` too.
"""

from __future__ import annotations

import argparse
import io
import json
import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, redirect_stdout
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as the command line does

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.signal import butter, sosfiltfilt

from api.factory import open_store
from api.settings import Settings
from bench.decision_cases import UNIT, Case, estimated, merged, moved, paper_bins, received, score
from bench.results_page import write_page
from bench.wheelset_motion import wheelset_motion
from estimation.filters import remove_wander
from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.assumptions import ClassLookup
from estimation.motion.integration import SignalParameters
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters, bin_parameters
from estimation.values.arrays import FloatArray
from estimation.values.geometry import COMBINATIONS, BinStatus, BinTable, WheelsetGeometry
from estimation.vehicle.regressors import REGRESSORS, YAW_TARGETS
from fleet_db.packed_values import pack_bin_table
from ingest.simulator.campaign import scenario_track, vehicle_run, wheelset_record
from ingest.simulator.fleet import run_fleet
from ingest.simulator.scenario_file import load_scenario

SEEDS = (15302, 1, 2)
TITLE = "Figures of the decision records"
LENGTHS_S = (20.0, 60.0, 300.0)
CUT_OFF = SignalParameters().cutoff_wavelength
WELL_FILLED = 1000  # samples in a bin
CREEP = ("longitudinal_creep_coefficient", "lateral_creep_coefficient", "lateral_spin_creep_coefficient")


def main() -> None:
    """Print everything, and write it as a page of results if asked."""
    parser = argparse.ArgumentParser("python -m bench.decisions", description="Print the numbers of docs/decisions.")
    parser.add_argument("demo", nargs="?", type=Path, help="folder of treadwatch demo, for the half life of forgetting")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/decisions.md too")
    options = parser.parse_args()
    printed = io.StringIO()
    with redirect_stdout(printed):
        measure(options.demo)
    print(printed.getvalue(), end="")
    if options.write_docs:
        command = "python -m bench.decisions --write-docs"
        block = f"```\n{printed.getvalue()}```"
        print(f"wrote {write_page('decisions', TITLE, command, [block])}")


def measure(demo: Path | None) -> None:
    """Print every measurement; that of forgetting only with the folder of a demo."""
    with tempfile.TemporaryDirectory(prefix="treadwatch-decisions-") as folder:
        reports = [
            run_fleet(replace(load_scenario("mems"), seed=seed), Path(folder) / f"seed-{seed}") for seed in SEEDS
        ]
        by_length = {s: [case for r in reports for case in received(r, s, Path(folder))] for s in LENGTHS_S}
    window_lengths(by_length)
    cases = by_length[60.0]
    cut_offs(cases)
    filters()
    groups(cases)
    parameters(cases)
    published_bins(cases)
    if demo is not None:
        half_lives(demo)


def window_lengths(by_length: dict[float, list[Case]]) -> None:
    """Print what the length of a window does."""
    print("windows")
    settings = EstimationSettings()
    for seconds, cases in by_length.items():
        estimates = estimated(cases)
        count = sum(len(case.windows) for case in cases)
        used = sum(float(e.samples.sum()) for e in estimates) / sum(len(w.valid) for c in cases for w in c.windows)
        tables = [
            bin_table.tabulate(m, paper_bins(settings.signals))
            for case in cases[:4]
            for m in moved(case, settings.signals)
        ]
        size = np.mean([len(pack_bin_table(table)) for table in tables])
        print(
            f"  {seconds:g} s: {count} windows, {100 * used:.1f} % of the samples used, "
            f"{size / 1e3:.0f} kB a bin table; {score(cases, estimates)}"
        )


def cut_offs(cases: Sequence[Case]) -> None:
    """Print what the cut-off wavelength does."""
    print("longest wavelength kept")
    for wavelength in (20.0, 30.0, 40.0, 60.0, 120.0):
        signals = SignalParameters(cutoff_wavelength=wavelength)
        print(f"  {wavelength:g} m: {score(cases, estimated(cases, signals))}")


def filters() -> None:
    """Print the error of the displacement behind smoother and a zero-phase Butterworth filter."""
    print("displacement from the wheelset's lateral acceleration, against the truth behind the same filter")
    found: dict[str, tuple[list[FloatArray], list[FloatArray]]] = {name: ([], []) for name in HIGH_PASS}
    for seed in SEEDS:
        scenario = replace(load_scenario("mems"), seed=seed)
        track = scenario_track(scenario)
        run = vehicle_run(scenario, track, scenario.vehicles[0], 0)
        dt, stride = 1 / scenario.sensors.rate_hz, scenario.sensors.stride
        for axle in range(4):
            true = wheelset_motion(scenario, track, run, axle)
            measured = wheelset_record(scenario, run, axle, true).values[:, 0]
            for y, along, a in _minutes(true.lateral_displacement[::stride], true.distance[::stride], measured, dt):
                for name, high_pass in HIGH_PASS.items():
                    error = high_pass(_twice_integrated(a, dt), along, dt) - high_pass(y, along, dt)
                    near, far = round(1 / dt), round(6 / dt)
                    found[name][0].append(error[far:-far])
                    found[name][1].append(np.concatenate([error[near:far], error[-far:-near]]))
    for name, (middle, ends) in found.items():
        print(
            f"  {name}: {1e3 * rms(middle):.4f} mm rms in the middle, {1e3 * rms(ends):.4f} mm from 1 to 6 s of an end"
        )


def _minutes(
    y: FloatArray, distance: FloatArray, measured: FloatArray, dt: float
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    n = round(60 / dt)
    for start in range(0, min(len(y), len(measured)) - n + 1, n):
        part = slice(start, start + n)
        yield np.asarray(y[part]), np.asarray(distance[part] - distance[start]), measured[part]


def _twice_integrated(acceleration: FloatArray, dt: float) -> FloatArray:
    velocity = cumulative_trapezoid(acceleration - acceleration.mean(), dx=dt, initial=0)
    t = np.arange(len(velocity))
    velocity -= np.polynomial.Polynomial.fit(t, velocity, 1)(t)
    return np.asarray(cumulative_trapezoid(velocity, dx=dt, initial=0))


def rms(parts: Sequence[FloatArray]) -> float:
    """Return the root mean square of all."""
    return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def smoother(values: FloatArray, distance: FloatArray, _dt: float) -> FloatArray:
    """Return what ``estimation.filters`` leaves of ``values``."""
    known = np.ones(len(values), dtype=np.bool_)
    return np.asarray(remove_wander(values[None, :], distance, known, CUT_OFF)[0])


def butterworth(values: FloatArray, distance: FloatArray, dt: float) -> FloatArray:
    """Return the rival: the same cut-off at the stretch's mean speed."""
    speed = float(distance[-1]) / (len(distance) * dt)
    return np.asarray(sosfiltfilt(butter(4, speed / CUT_OFF, "high", fs=1 / dt, output="sos"), values))


HIGH_PASS = {"smoother": smoother, "Butterworth, 4th order, forward and back": butterworth}


def groups(cases: Sequence[Case]) -> None:
    """Print what number of groups and length of blocks do, and what a covariance of single samples would say."""
    print("groups of the jackknife, blocks")
    for number in (4, 8, 16, 32):
        print(f"  {number} groups of blocks of 20 s: {score(cases, estimated(cases, None, _grouped(number)))}")
    for block_s in (0.1, 1.0, 5.0, 20.0):
        estimates = estimated(cases, SignalParameters(block_s=block_s), published=_certain())
        spread = 1e3 * np.nanmedian(_spread(estimates))
        print(f"  blocks of {block_s:g} s: std of rL - rR {spread:.4f} mm, median over bins")
    settings = EstimationSettings()
    naive = np.concatenate([_naive(merged(moved(c, settings.signals), paper_bins(settings.signals))) for c in cases])
    print(f"  as if samples were independent: {1e3 * np.median(naive):.4f} mm")


def _grouped(number: int) -> Callable[[BinParameters], BinParameters]:
    return lambda parameters: replace(parameters, groups=number)


def _certain() -> GeometryParameters:
    return GeometryParameters(uncertainty=ParameterUncertainty(0.0, 0.0, 0.0, inverse_friction=0.0))


def _spread(estimates: Sequence[WheelsetGeometry]) -> FloatArray:
    return np.concatenate([e.rolling_radius_difference.std[e.samples > WELL_FILLED] for e in estimates])


def _naive(table: BinTable) -> FloatArray:
    packed, weight = table.yaw.sum(axis=0), table.weight.sum(axis=0)
    solution = bin_table.solve(packed, weight, REGRESSORS, len(YAW_TARGETS))
    return np.asarray(np.sqrt(solution.residual_variance * solution.inverse[:, 1, 1])[weight > WELL_FILLED])


def parameters(cases: Sequence[Case]) -> None:
    """Print what the uncertainty of the vehicle parameters hides, and whether first order is enough."""
    print("vehicle parameters")
    for name, published in (("known", _certain()), ("shipped uncertainty", GeometryParameters())):
        estimates = estimated(cases, published=published)
        shares = []
        for combination in COMBINATIONS:
            status = [s for e in estimates for s in getattr(e, combination).status if s is not BinStatus.TOO_FEW]
            shares.append(f"{combination} {sum(s is BinStatus.ESTIMATED for s in status)} of {len(status)}")
        print(f"  {name}: bins published: {', '.join(shares)}; {score(cases, estimates)}")
    for factor in (0.8, 1.2):
        _changed(cases, factor)
    case, settings = cases[2], EstimationSettings()
    table = merged(moved(case, settings.signals), paper_bins(settings.signals))
    began = time.perf_counter()
    for _ in range(20):
        estimate_geometry(table, paper_bins(settings.signals), settings.geometry)
    print(f"  a geometry with intervals from its table: {1e3 * (time.perf_counter() - began) / 20:.1f} ms")


def published_bins(cases: Sequence[Case]) -> None:
    """Print how far the published bins are from the truth."""
    print("bins, MEMS sensors")
    estimates = estimated(cases)
    for name in COMBINATIONS:
        errors, stds = [], []
        for case, estimate in zip(cases, estimates, strict=True):
            values, scale = getattr(estimate, name), 1e3 if UNIT[name] == "mm" else 1.0
            centre = 1e3 * estimate.bin_centres
            error = scale * values.value - np.interp(centre, case.displacement_mm, case.curves[name])
            errors.append(error[np.isfinite(error)])
            stds.append(scale * values.std[np.isfinite(error)])
        error, std = np.concatenate(errors), np.concatenate(stds)
        if len(error):
            print(
                f"  {name}: {len(error)} published, error {np.sqrt(np.mean(error**2)):.4f} {UNIT[name]} rms, "
                f"median std {np.median(std):.4f}, {100 * np.mean(np.abs(error) <= 1.96 * std):.0f} % within 1.96 std"
            )


def _changed(cases: Sequence[Case], factor: float) -> None:
    """All creep coefficients wrong by ``factor``: the conicity itself, and what the sensitivities foretold."""

    def wrong(given: BinParameters) -> BinParameters:
        v = given.vehicle
        return replace(given, vehicle=replace(v, **{name: factor * getattr(v, name) for name in CREEP}))

    changes = ((f"creep coefficients x {factor:g}", wrong), (f"yaw stiffness x {factor:g}", _stiffness(factor)))
    for name, change in changes:
        print(f"  {name}: {score(cases, estimated(cases, change=change))}")


def _stiffness(factor: float) -> Callable[[BinParameters], BinParameters]:
    return lambda given: replace(
        given, vehicle=replace(given.vehicle, yaw_stiffness=factor * given.vehicle.yaw_stiffness)
    )


def half_lives(demo: Path) -> None:
    """Print what forgetting does to the current conicity of the demo's fleet at 3 mm."""
    print("half life, on the demo's fleet: estimate at 3 mm against the truth of the last campaign with data")
    settings = EstimationSettings()
    truths = json.loads((demo / "recordings" / "truth.json").read_text(encoding="utf-8"))["wheelsets"]
    lives = (500.0, 2_000.0, 10_000.0, 20_000.0, 50_000.0, 1e9)
    found: dict[float, list[tuple[float, float, bool]]] = {life: [] for life in lives}
    with closing(open_store(Settings(data_dir=demo / "data", database_url=None))) as storage, storage.read() as unit:
        for truth in truths:
            since = max((r.at_ns for r in unit.registry.wheelset(truth["serial"]).reprofilings), default=0)
            mounting = unit.registry.wheelset(truth["serial"]).mounting
            assumed = ClassLookup(unit, settings).assumed(mounting.vehicle, truth["serial"])
            bins = bin_parameters(assumed.windows)
            tables = [(w.mileage_km, table) for w, table, _ in unit.tables.stream(truth["serial"], since, None)]
            last = min(truth["campaigns"], key=lambda c: abs(c["mileage_km"] - tables[-1][0]))
            true = float(np.interp(3.0, last["amplitude_mm"], last["equivalent_conicity"]))
            for life in lives:
                table = bin_table.weighted_sum((0.5 ** ((tables[-1][0] - km) / life), table) for km, table in tables)
                at = estimate_geometry(table, bins, settings.geometry).conicity
                value = at[int(np.argmin(np.abs(np.array(settings.geometry.curve.amplitudes) - 3e-3)))]
                if value.value is not None and value.low is not None and value.high is not None:
                    found[life].append((value.value - true, value.high - value.low, value.low <= true <= value.high))
    for life, rows in found.items():
        errors, widths, covered = (np.array(column, dtype=np.float64) for column in zip(*rows, strict=True))
        print(
            f"  {life:,.0f} km: mean error {errors.mean():+.4f}, largest {np.abs(errors).max():.4f}, "
            f"half width {widths.mean() / 2:.4f}, {covered.sum():.0f} of {len(rows)} cover"
        )


if __name__ == "__main__":
    main()
