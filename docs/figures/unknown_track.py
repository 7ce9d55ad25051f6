"""Draw docs/img/unknown_track.png: what a fleet finds of a section that nobody has surveyed. Run: python docs/figures/unknown_track.py [FOLDER].

FOLDER keeps the recordings; the run takes some minutes on one core.
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

from api.comparison.study import TrueWheelset, read_truth
from api.comparison.trial import deploy, opened, receive, record, run_jobs
from estimation.filters import high_pass, local_cubic_kernel
from estimation.values.geometry import WheelsetGeometry
from estimation.values.track import TrackAlignment
from ingest.simulator.campaign import scenario_track
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.scenario import PositionErrors
from ingest.simulator.scenario_file import load_scenario
from ingest.simulator.track import TrackTruth

SCENARIO, SEED = "gauge_2mm_unknown", 0
SHOWN = (6000.0, 6250.0)  # m
TRUE, FOUND = "#222222", "#d1495b"


def main(folder: Path) -> None:
    """Simulate, ingest, run the jobs, draw what is stored."""
    scenario = replace(with_seed(load_scenario(SCENARIO), SEED), position=PositionErrors(0.0, 0.0))
    recorded = record(scenario, folder)
    with tempfile.TemporaryDirectory() as data:
        settings = deploy(scenario, Path(data))
        receive(recorded, settings)
        truths = read_truth(recorded.truth)[::5]
        with opened(settings) as (storage, context):
            run_jobs(context)
            with storage.read() as unit:
                found = unit.tracks.alignment(scenario.section.code)
                records = [unit.geometries.current(truth.serial) for truth in truths]
    assert found is not None
    figure = Figure(figsize=(9.0, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    places, gauges, curves = figure.subplots(3, 1)
    for axes, what in ((places, "alignment"), (gauges, "gauge_deviation")):
        _along(axes, scenario_track(scenario), found, what=what)
    for truth, current in zip(truths, records, strict=True):
        if current is not None:
            _wheelset(curves, truth, current.geometry)
    curves.set_xlim(-5, 5)
    curves.set_ylim(-4, 4)
    curves.set_xlabel("lateral displacement y - d, mm")
    curves.set_ylabel("rL - rR at nominal gauge, mm")
    figure.savefig("docs/img/unknown_track.png", dpi=110)


def _along(axes: Axes, truth: TrackTruth, track: TrackAlignment, what: str) -> None:
    step = float(track.s[1] - track.s[0])
    true = np.interp(track.s, truth.s, getattr(truth, what))
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
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, borderaxespad=0.1)


def _wheelset(axes: Axes, truth: TrueWheelset, geometry: WheelsetGeometry) -> None:
    offset = float(np.interp(0.0, truth.displacement, truth.difference))
    centres = 0.5 * (geometry.bin_edges[:-1] + geometry.bin_edges[1:])
    value = geometry.rolling_radius_difference.value
    middle = float(np.interp(0.0, centres[np.isfinite(value)], value[np.isfinite(value)]))
    axes.plot(1e3 * truth.displacement, 1e3 * (truth.difference - offset), color=TRUE, linewidth=1.0)
    axes.plot(1e3 * centres, 1e3 * (value - middle), color=FOUND, linewidth=1.0)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(Path(temporary))
