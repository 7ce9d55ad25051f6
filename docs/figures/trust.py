"""Draw docs/img/trust-*.png: errors beside intervals, forecasts beside what happened, refused beside wrong. Run: python docs/figures/trust.py.

The first and the last are of ``bench-results/vehicles.jsonl``, which ``python -m bench vehicles`` writes; the second
runs the forecasts of one railway.
"""  # noqa: INP001, E501 - a script, not a package; a command to copy

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bench.trend import FITTERS
from bench.vehicles import ROWS
from bench.wear_lives import MIXED, lives

RESULTS, IMAGES = Path("bench-results/vehicles.jsonl"), Path("docs/img")
INK, GOOD, BAD, PALE = "#222222", "#2f6f9f", "#d1495b", "#c9d3dc"
AMPLITUDE = 3e-3  # m
FORECASTS = 60
HORIZON_KM = 500_000.0
MOST_SHARE = 2.0  # of the half width; what is further off stands there

Case = Mapping[str, Any]


def main() -> None:
    """Draw the three pictures."""
    cases = [json.loads(line) for line in RESULTS.read_text(encoding="utf-8").splitlines()]
    right = [case for case in cases if ROWS[case["row"]] is not None]
    _draw("trust-intervals.png", lambda axes: _intervals(axes, right), (9.0, 4.6))
    _draw("trust-forecasts.png", _forecasts, (9.0, 5.2))
    _draw("trust-refusals.png", lambda axes: _refusals(axes, cases), (9.0, 0.28 * len(_by_row(cases)) + 1.4))


def _draw(name: str, paint: Any, size: tuple[float, float]) -> None:  # noqa: ANN401 - a function of axes
    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots()
    axes.spines[["top", "right"]].set_visible(False)
    paint(axes)
    figure.savefig(IMAGES / name, dpi=110)


def _by_row(cases: Sequence[Case]) -> dict[str, list[Case]]:
    return {row: of_row for row in ROWS if (of_row := [case for case in cases if case["row"] == row])}


def _intervals(axes: Axes, cases: Sequence[Case]) -> None:
    """Draw the error of every published conicity over its half width, by the half width: 95 of 100 should be within."""
    compared = (number for case in cases for item in case["wheelsets"] for number in item["compared"])
    published = [number for number in compared if number is not None]
    error, half = 1e3 * np.array([number[:2] for number in published]).T
    share = np.clip(error / half, -MOST_SHARE, MOST_SHARE)
    outside = np.abs(error) > half
    axes.axhspan(-1.0, 1.0, color=PALE, alpha=0.6, linewidth=0)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.scatter(half[~outside], share[~outside], s=6, color=GOOD, alpha=0.4, linewidths=0)
    axes.scatter(half[outside], share[outside], s=10, color=BAD, linewidths=0)
    axes.set_xscale("log")
    axes.set_ylim(-MOST_SHARE * 1.05, MOST_SHARE * 1.05)
    ticks = [width for width in (2, 5, 10, 20, 50, 100, 200) if half.min() <= width <= half.max()]
    axes.set_xticks(ticks, [f"{width / 1e3:g}" for width in ticks])
    axes.minorticks_off()
    axes.set_xlabel("half width of the 95 % interval of the conicity")
    axes.set_ylabel("estimated less true, over the half width")
    held = 100.0 * float(np.mean(~outside))
    axes.set_title(
        f"{len(error):,} conicities at 1 to 3 mm: the interval (grey) holds the truth in {held:.1f} %",
        loc="left",
        fontsize=10,
    )


def _forecasts(axes: Axes) -> None:
    """Draw when wheelsets reached their limit, each with the 80 % interval that was forecast."""
    simulated = lives(MIXED, 0)
    forecasts = FITTERS["product"]([life.observed for life in simulated])
    pairs = [(life, made) for life, made in zip(simulated, forecasts, strict=True) if made is not None]
    chosen = [pairs[k] for k in np.linspace(0, len(pairs) - 1, FORECASTS).astype(int)]
    chosen.sort(key=lambda pair: min(pair[0].distance_km, HORIZON_KM))
    held = 0
    for place, (life, made) in enumerate(chosen):
        low, middle, high = (made.quantile(probability) / 1e3 for probability in (0.1, 0.5, 0.9))
        happened = min(life.distance_km, HORIZON_KM) / 1e3
        inside = low <= happened <= high
        held += inside
        axes.plot([place, place], [low, high], color=GOOD if inside else BAD, alpha=0.55, linewidth=4)
        axes.plot(place, middle, "_", color=INK, markersize=6)
        axes.plot(place, happened, "o", color=INK, markersize=3)
    axes.set_xlabel(f"{FORECASTS} wheelsets of mixed fleets, in the order of what happened")
    axes.set_ylabel("distance to the limit, thousand km")
    axes.set_ylim(0.0, HORIZON_KM / 1e3 * 1.02)
    axes.set_title(
        f"Dots: when the limit was reached. Bars: p10 to p90 as forecast, which should hold 48; they hold {held}",
        loc="left",
        fontsize=10,
    )


def _refusals(axes: Axes, cases: Sequence[Case]) -> None:
    """Draw of each kind of vehicle the share that is published, published with a doubt, and refused."""
    rows = _by_row(cases)
    for place, (row, of_row) in enumerate(rows.items()):
        verdicts = [verdict for case in of_row for verdict in case["verdicts"]]
        good = sum(verdict["published"] and not verdict["code"] for verdict in verdicts) / len(verdicts)
        doubted = sum(verdict["published"] and bool(verdict["code"]) for verdict in verdicts) / len(verdicts)
        wrong = ROWS[row] is None
        left = 0.0
        for share, colour in ((good, BAD if wrong else GOOD), (doubted, "#e0b04c"), (1.0 - good - doubted, PALE)):
            axes.barh(-place, share, left=left, color=colour, height=0.8)
            left += share
    axes.set_yticks([-place for place in range(len(rows))], [row.replace("_", " ") for row in rows], fontsize=8)
    for label, row in zip(axes.get_yticklabels(), rows, strict=True):
        label.set_color(BAD if ROWS[row] is None else INK)
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("share of the wheelsets")
    axes.set_title(
        "Published (blue; red where the registry is wrong), published with a doubt (yellow), refused (grey)",
        loc="left",
        fontsize=10,
    )


if __name__ == "__main__":
    main()
