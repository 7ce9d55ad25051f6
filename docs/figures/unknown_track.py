"""Draw docs/img/unknown_track.png: what the passes of a fleet tell of a section. Run: python docs/figures/unknown_track.py [FOLDER].

FOLDER keeps the simulation; the run takes some minutes on one core.
"""  # noqa: INP001, E501 - a script, not a package; a command to copy

from __future__ import annotations

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from estimation.estimators.tracks import section_passes
from estimation.filters.local_cubic import high_pass, local_cubic_kernel
from estimation.jobs.settings import EstimationSettings
from estimation.track.results import LIFE
from estimation.track.section import SectionEstimate, estimate_section
from estimation.track.settings import AlignmentSettings
from ingest.simulator.section_file import load_section_scenario
from ingest.simulator.section_run import SECTION, SectionRun, simulate_section

SCENARIO, SEED = "gauge_2mm_unknown", 0
SHOWN = (6000.0, 6250.0)  # m
TRUE, FOUND = "#222222", "#d1495b"


def main(folder: Path) -> None:
    """Simulate, estimate, draw."""
    scenario = replace(load_section_scenario(SCENARIO), position_offset=0.0, position_scale=0.0)
    run = simulate_section(scenario, SEED, folder)
    settings = AlignmentSettings()
    found = section_passes(run.all_windows(), EstimationSettings().windows, settings)
    estimate = estimate_section(SECTION, found, None, settings.section)
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    places, gauges, curves = figure.subplots(3, 1)
    _along(places, run, estimate, what="alignment")
    _along(gauges, run, estimate, what="gauge_deviation")
    _wheels(curves, run, estimate)
    figure.savefig("docs/img/unknown_track.png", dpi=110)


def _along(axes: Axes, run: SectionRun, estimate: SectionEstimate, what: str) -> None:
    track = estimate.alignment
    assert track is not None
    step = float(track.s[1] - track.s[0])
    true = np.interp(track.s, run.track.s, getattr(run.track, what))
    if what == "alignment":
        true = high_pass(true, local_cubic_kernel(track.cutoff_wavelength, step))
    shown = (track.s >= SHOWN[0]) & (track.s <= SHOWN[1])
    inner = (track.s > SHOWN[0] / 10) & (track.s < track.s[-1] - SHOWN[0] / 10)
    value, std = getattr(track, what), getattr(track, f"{what}_std")
    error = 1e3 * float(np.nanstd((value - true)[inner]))
    s = track.s[shown]
    axes.plot(s, 1e3 * true[shown], color=TRUE, linewidth=1.0, label="true")
    axes.plot(s, 1e3 * value[shown], color=FOUND, linewidth=1.0, label=f"from 48 passes, error {error:.2f} mm SD")
    low, high = (1e3 * (value + sign * 1.96 * std)[shown] for sign in (-1, 1))
    axes.fill_between(s, low, high, color=FOUND, alpha=0.2, linewidth=0)
    axes.set_ylabel(f"{what.replace('_', ' ')}, mm")
    axes.set_xlabel("distance, m")
    axes.legend(loc="upper right")


def _wheels(axes: Axes, run: SectionRun, estimate: SectionEstimate) -> None:
    solution = estimate.solution
    assert solution is not None
    names = [name.split(LIFE)[0] for name in solution.wheelsets]
    for truth in run.wheelsets[::5]:
        offset = float(np.interp(0.0, truth.displacement, truth.difference))
        axes.plot(1e3 * truth.displacement, 1e3 * (truth.difference - offset), color=TRUE, linewidth=1.0)
        curve = solution.curves[0, names.index(truth.serial), : len(solution.knots)]
        axes.plot(1e3 * curve, 1e3 * solution.knots, color=FOUND, linewidth=1.0)
    axes.set_xlim(-5, 5)
    axes.set_ylim(-4, 4)
    axes.set_xlabel("lateral displacement y - d, mm")
    axes.set_ylabel("rL - rR at nominal gauge, mm")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
