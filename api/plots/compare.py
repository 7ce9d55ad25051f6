"""The comparison as a picture: a wheelset's conicity by every estimator, and everybody's errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from api.comparison.report import TOLD, titles
from api.comparison.study import PairStudy, Told
from estimation.contact.conicity import equivalent_conicity
from estimation.estimators.catalogue import SHIPPED
from estimation.estimators.interface import CurveEstimate
from estimation.values.arrays import FloatArray

COLOURS = {"bins": "#1f5fa8", "linear": "#c2571a", "paper": "#3a8a4d", "cubic": "#8a4fa3"}
MARKERS = {"bins": "o", "linear": "s", "paper": "^", "cubic": "D"}
_MM = 1e3
_AMPLITUDES = np.linspace(0.5e-3, 6e-3, 111)


def save_comparison(studies: Sequence[PairStudy], path: Path) -> None:
    """Draw one column a pair and write it to ``path`` as PNG."""
    figure = Figure(figsize=(6.2 * len(studies), 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2, len(studies), squeeze=False)
    for column, study in enumerate(studies):
        _conicity(grid[0, column], study)
        _errors(grid[1, column], study)
    top = max(axes.get_ylim()[1] for axes in grid[0])
    ends = [axes.get_ylim() for axes in grid[1]]
    for above, below in grid.T:
        above.set_ylim(0.0, top)
        below.set_ylim(min(low for low, _ in ends), max(high for _, high in ends))
    handles, names = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=3, frameon=False)
    figure.savefig(path, dpi=110)


def _conicity(axes: Axes, study: PairStudy) -> None:
    """Conicity by amplitude of the example, on the alignment of the fleet, or on known track without one."""
    told = Told.FLEET if Told.FLEET not in study.untold else Told.KNOWN
    truth = study.example.truth
    true = equivalent_conicity(truth.displacement, truth.difference, _AMPLITUDES)
    axes.plot(_MM * _AMPLITUDES, true, color="black", linewidth=2.2, label="truth", zorder=5)
    for name, title in titles().items():
        found = study.example.curves[told, name]
        value, low, high = _arrays(found)
        if name == SHIPPED:
            axes.fill_between(
                _MM * found.amplitude, low, high, color=COLOURS[name], alpha=0.2, linewidth=0,
                label=f"{title}: 95 % interval",
            )  # fmt: skip
        axes.plot(
            _MM * found.amplitude, value, color=COLOURS[name], marker=MARKERS[name], markersize=4, linewidth=1.2,
            label=title,
        )  # fmt: skip
    axes.set_title(f"{study.pair}: wheelset {truth.serial}, track {TOLD[told]}")
    axes.set_xlabel("amplitude (mm)")
    axes.set_ylabel("equivalent conicity")
    axes.grid(alpha=0.3)


def _arrays(found: CurveEstimate) -> tuple[FloatArray, FloatArray, FloatArray]:
    rows = [
        (np.nan, np.nan, np.nan) if item.value is None else (item.value, item.low, item.high) for item in found.conicity
    ]
    value, low, high = np.array(rows, dtype=np.float64).T
    return value, low, high


def _errors(axes: Axes, study: PairStudy) -> None:
    """Every wheelset's error as a dot, the median as a bar, by what was told of the track; on a scale of ratios."""
    tolds = [told for told in Told if told not in study.untold]
    names = list(titles())
    rng = np.random.default_rng(0)
    for place, told in enumerate(tolds):
        for order, name in enumerate(names):
            score = next(item for item in study.scores if item.told is told and item.estimator == name)
            x = place + 0.2 * (order - 0.5 * (len(names) - 1))
            beside = x + rng.uniform(-0.05, 0.05, len(score.errors))
            axes.plot(beside, score.errors, MARKERS[name], color=COLOURS[name], markersize=3.5, alpha=0.55)
            if score.errors:
                axes.hlines(score.median, x - 0.09, x + 0.09, color=COLOURS[name], linewidth=2.5)
    axes.set_xticks(range(len(tolds)), [f"track {TOLD[told]}" for told in tolds])
    axes.set_yscale("log")
    ticks = [1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_ylabel("mean error over 1-3 mm (bar: median)")
    axes.grid(axis="y", alpha=0.3)
