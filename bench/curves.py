"""What an estimate loses where the whole run is in one curve that is not on file: how straight is straight."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np

from bench.report import BenchRow
from bench.signal_cases import Wheelset, on_track, wheelsets
from bench.signals import score
from estimation.geometry.estimate import estimate_geometry
from estimation.jobs.settings import EstimationSettings
from estimation.motion.integration import SignalParameters
from estimation.motion.window_motion import motion
from estimation.tables import bin_table
from estimation.tables.bin_table import BinParameters
from estimation.values.reasons import Reason
from ingest.simulator.track import Curve

RADII_KM = (np.inf, 20.0, 10.0, 5.0, 3.0)
BALANCED = 0.7  # share of the lateral acceleration at 20 m/s that the cant takes
SEED = 1


def rows() -> Iterator[BenchRow]:
    """Yield one row per radius."""
    tasks = [(number, radius) for radius in RADII_KM for number in range(len(wheelsets()) - 1)]
    with ProcessPoolExecutor(2) as pool:
        found = dict(zip(tasks, pool.map(_one, tasks), strict=True))
    straight = np.mean([found[number, np.inf][1] for number in range(len(wheelsets()) - 1)])
    limit = 1e-3 / SignalParameters().sharpest_curvature
    for radius in RADII_KM:
        here = [found[number, radius] for number in range(len(wheelsets()) - 1)]
        shift, error = (float(np.mean([values[i] for values in here])) for i in (0, 1))
        cover = np.mean([c for values in here for c in values[2]])
        yield BenchRow(
            f"run in a curve of {radius:g} km: shift, and equivalent conicity, error over 1-3 mm",
            f"{1e3 * shift:.2f} mm outwards; {error:.4f}; {100 * cover:.0f} % of intervals cover",
            "within 0.001 of straight track" if radius >= limit else "left out",
            bool(radius < limit or error < straight + 0.001),
        )


def _one(task: tuple[int, float]) -> tuple[float, float, tuple[bool, ...]]:
    number, radius_km = task
    wheelset: Wheelset = wheelsets()[number]
    cant = 2 * 0.7452 * 400.0 / (1e3 * radius_km) / 9.81 * BALANCED
    curves = (Curve(-500.0, 30_000.0, 1e3 * radius_km, cant, 100.0),) if np.isfinite(radius_km) else ()
    run = on_track(wheelset, "mixed", SEED, curves)
    settings = EstimationSettings(signals=replace(SignalParameters(), max_cant_deficiency_change=np.inf))
    bins = BinParameters(source=settings.signals.source, band_limited=True)
    moved = (motion(window, run.track, settings.signals) for window in run.windows)
    tables = [bin_table.tabulate(item, bins) for item in moved if not isinstance(item, Reason)]
    found = estimate_geometry(bin_table.merge_all(tables, bins), bins, settings.geometry)
    error, _, covered = score(found, run.conicity)
    straight = 0.0 if np.isinf(radius_km) else -float(run.motion.relative_displacement.mean())
    return straight, error, covered
