"""The comparison as a picture: a wheelset's conicity by every estimator, and the errors of all wheelsets."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from api.comparison.report import TRACKS, titles
from api.comparison.study import PairStudy, TrackInformation
from estimation.contact.conicity import equivalent_conicity
from estimation.estimators.catalogue import SHIPPED
from estimation.values.arrays import FloatArray
from estimation.values.geometry import WheelsetGeometry

_STYLES = (  # colour and marker, in the order of the catalogue
    ("#1f5fa8", "o"),
    ("#c2571a", "s"),
    ("#3a8a4d", "^"),
    ("#8a4fa3", "D"),
    ("#b03060", "v"),
    ("#6b6b00", "P"),
    ("#12908e", "X"),
    ("#4d4d4d", "<"),
)
_WIDTH = 0.84  # of the estimators of one track, between ticks 1 apart
_MM = 1e3
_AMPLITUDES = np.linspace(0.5e-3, 6e-3, 111)


def save_comparison(studies: Sequence[PairStudy], path: Path) -> None:
    """Draw one column a pair and write it to ``path`` as PNG."""
    figure = Figure(figsize=(6.2 * len(studies), 8.6), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(2, len(studies), squeeze=False)
    for column, study in enumerate(studies):
        _conicity(grid[0, column], study)
        draw_errors(grid[1, column], study)
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
    track = TrackInformation.FLEET
    if track in study.unestimated:
        track = TrackInformation.KNOWN
    truth = study.example.truth
    true = equivalent_conicity(truth.displacement, truth.difference, _AMPLITUDES)
    axes.plot(_MM * _AMPLITUDES, true, color="black", linewidth=2.2, label="truth", zorder=5)
    for order, (name, title) in enumerate(titles().items()):
        found = study.example.geometries.get((track, name))
        if found is None:
            continue
        colour, marker = _style(order)
        value, low, high = _arrays(found)
        if name == SHIPPED:
            axes.fill_between(
                _MM * found.amplitude, low, high, color=colour, alpha=0.2, linewidth=0,
                label=f"{title}: 95 % interval",
            )  # fmt: skip
        axes.plot(
            _MM * found.amplitude, value, color=colour, marker=marker, markersize=4, linewidth=1.2,
            label=title,
        )  # fmt: skip
    axes.set_title(f"{study.pair}: wheelset {truth.serial}, track {TRACKS[track]}")
    axes.set_xlabel("amplitude (mm)")
    axes.set_ylabel("equivalent conicity")
    axes.grid(alpha=0.3)


def _style(order: int) -> tuple[str, str]:
    """Return colour and marker of the estimator at a place of the catalogue."""
    return _STYLES[order % len(_STYLES)]


def _arrays(found: WheelsetGeometry) -> tuple[FloatArray, FloatArray, FloatArray]:
    rows = [
        (np.nan, np.nan, np.nan) if item.value is None else (item.value, item.low, item.high) for item in found.conicity
    ]
    value, low, high = np.array(rows, dtype=np.float64).T
    return value, low, high


def draw_errors(axes: Axes, study: PairStudy) -> None:
    """Draw every wheelset's error as a dot, the median as a bar, by information on the track; on a logarithmic scale.

    Args:
        axes: Where to; empty.
        study: The scores of every estimator on every track.
    """
    tracks = [track for track in TrackInformation if track not in study.unestimated]
    names = list(titles())
    rng, step = np.random.default_rng(0), _WIDTH / len(names)
    for place, track in enumerate(tracks):
        for order, name in enumerate(names):
            score = next(item for item in study.scores if item.track is track and item.estimator == name)
            colour, marker = _style(order)
            x = place + step * (order - 0.5 * (len(names) - 1))
            beside = x + rng.uniform(-0.25, 0.25, len(score.errors)) * step
            axes.plot(beside, score.errors, marker, color=colour, markersize=3.5, alpha=0.55)
            if score.errors:
                axes.hlines(score.median, x - 0.4 * step, x + 0.4 * step, color=colour, linewidth=2.5)
        if not any(item.errors for item in study.scores if item.track is track):
            at = axes.get_xaxis_transform()
            axes.text(place, 0.5, "nothing estimated", transform=at, ha="center", color="dimgrey", fontsize=9)
    axes.set_xlim(-0.5, len(tracks) - 0.5)
    axes.set_xticks(range(len(tracks)), [f"track\n{TRACKS[track]}" for track in tracks])
    axes.set_yscale("log")
    ticks = [1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_ylabel("mean error over 1-3 mm (bar: median)")
    axes.grid(axis="y", alpha=0.3)
