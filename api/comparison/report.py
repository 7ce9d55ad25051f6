"""The comparison as a table, as sentences computed from it, as JSON and as a picture."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from rich.table import Table

from api.comparison.study import PairStudy, Score, TrackInformation
from estimation.contact.conicity import equivalent_conicity
from estimation.estimators.catalogue import SHIPPED, estimators
from estimation.values.fields import JsonValue
from estimation.values.units import IN_MM

TRACKS = {
    TrackInformation.KNOWN: "known",
    TrackInformation.FLEET: "from the fleet",
    TrackInformation.NONE: "not known (d = 0)",
}
LEAST_ESTIMATED = 0.5  # share of the amplitudes that an estimator must estimate to win anything
OF_USE = 0.05  # error, 95th percentile, beyond which the nearest is not near


def titles() -> dict[str, str]:
    """Return the titles of the estimators, keyed by their names."""
    return {item.name: item.title for item in estimators()}


def table(studies: Sequence[PairStudy]) -> Table:
    """Return how near each estimator comes, for a terminal."""
    shown = Table(
        "pair", "track", "estimator", "median", "95th", "nearest", "cover", "given", "s",
        title="Equivalent conicity: mean absolute error over 1-3 mm per wheelset, median and 95th percentile; "
        "for how many wheelsets it is the nearest; "
        "share of 95 % intervals that cover, of amplitudes that are given; seconds from the store to geometries",
        title_justify="left",
    )  # fmt: skip
    for study in studies:
        for score, cells in _rows(study):
            shown.add_row(score.pair, TRACKS[score.track], score.estimator, *cells)
        shown.add_section()
    return shown


def markdown(studies: Sequence[PairStudy]) -> str:
    """Return the same as a Markdown table."""
    head = (
        "pair", "track", "estimator", "median", "95th percentile", "nearest for", "intervals that cover", "estimated",
        "seconds",
    )  # fmt: skip
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * 3 + " ---: |" * (len(head) - 3)]
    named = titles()
    for score, cells in (row for study in studies for row in _rows(study)):
        lines.append("| " + " | ".join([score.pair, TRACKS[score.track], named[score.estimator], *cells]) + " |")
    return "\n".join(lines) + "\n"


def _rows(study: PairStudy) -> Iterator[tuple[Score, list[str]]]:
    won = nearest(study)
    for score in study.scores:
        given = score.estimated / score.amplitudes if score.amplitudes else math.nan
        errors = [f"{value:.4f}" if math.isfinite(value) else "-" for value in (score.median, score.p95)]
        shares = [f"{value:.0%}" if math.isfinite(value) else "-" for value in (score.coverage, given)]
        yield score, [*errors, str(won[score.track, score.estimator]), *shares, f"{score.seconds:.1f}"]


def nearest(study: PairStudy) -> dict[tuple[TrackInformation, str], int]:
    """Return for how many wheelsets each estimator has the least error, by information on the track."""
    best = {(score.track, score.estimator): 0 for score in study.scores}
    for track in TrackInformation:
        scores = [score for score in study.scores if score.track is track]
        for k in range(max((len(score.by_wheelset) for score in scores), default=0)):
            errors = {score.estimator: score.by_wheelset[k] for score in scores if math.isfinite(score.by_wheelset[k])}
            if errors:
                best[track, min(errors, key=errors.__getitem__)] += 1
    return best


def sentences_of(studies: Sequence[PairStudy]) -> list[str]:
    """Return one sentence for each pair and information on the track: the most accurate estimator, by how much."""
    nothing = "nothing is estimated"
    return [
        f"{study.pair}, track {TRACKS[track]}: {nothing}: {study.unestimated[track]}."
        if track in study.unestimated
        else _winner(study, track)
        for study in studies
        for track in TrackInformation
    ]


def as_json(studies: Sequence[PairStudy], scenario: str) -> dict[str, JsonValue]:
    """Return every figure; null where there is none."""
    return {
        "scenario": scenario,
        "pairs": [
            {
                "pair": study.pair,
                "seed": study.seed,
                "track_seconds": round(study.track_seconds, 3),
                "unestimated": {track.value: reason for track, reason in study.unestimated.items()},
                "scores": [
                    {
                        "track": score.track.value,
                        "estimator": score.estimator,
                        "median_error": _number(score.median),
                        "p95_error": _number(score.p95),
                        "coverage": _number(score.coverage),
                        "amplitudes": score.amplitudes,
                        "estimated": score.estimated,
                        "wheelsets": score.wheelsets,
                        "seconds": round(score.seconds, 3),
                        "errors": [_number(error) for error in score.by_wheelset],
                    }
                    for score in study.scores
                ],
            }
            for study in studies
        ],
        "sentences": [*sentences_of(studies)],
    }


def _winner(study: PairStudy, track: TrackInformation) -> str:
    named, won, where = titles(), nearest(study), f"{study.pair}, track {TRACKS[track]}"
    scores = [score for score in study.scores if score.track is track]
    fit = [score for score in scores if score.errors and score.estimated >= LEAST_ESTIMATED * score.amplitudes]
    if not fit:
        return f"{where}: no estimator estimates half of the amplitudes."
    order = sorted(fit, key=lambda score: score.p95)
    best = order[0]
    figures = f"95th percentile {best.p95:.4f}, median {best.median:.4f}"
    if best.p95 > OF_USE:
        return f"{where}: none comes near; the nearest are {named[best.estimator]} ({figures})."
    figures += f", nearest for {won[track, best.estimator]} of {best.wheelsets} wheelsets"
    product = next((score for score in fit if score.estimator == SHIPPED), None)
    if best is product:
        if len(order) == 1:
            return f"{where}: {named[SHIPPED]} alone estimates half of the amplitudes ({figures})."
        second = order[1]
        return f"{where}: {named[SHIPPED]} win ({figures}); {named[second.estimator]} follows with {second.p95:.4f}."
    if product is None:
        return f"{where}: a baseline wins, {named[best.estimator]} ({figures}); {named[SHIPPED]} estimate too little."
    return (
        f"{where}: a baseline wins, {named[best.estimator]} ({figures}); "
        f"{named[SHIPPED]} reach {product.p95:.4f}, median {product.median:.4f}."
    )


def _number(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None


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
    track = TrackInformation.KNOWN if TrackInformation.FLEET in study.unestimated else TrackInformation.FLEET
    truth = study.example.truth
    true = equivalent_conicity(truth.displacement, truth.difference, _AMPLITUDES)
    axes.plot(IN_MM * _AMPLITUDES, true, color="black", linewidth=2.2, label="truth", zorder=5)
    for order, (name, title) in enumerate(titles().items()):
        geometry = study.example.geometries.get((track, name))
        if geometry is None:
            continue
        colour, marker = _style(order)
        values = [(conicity.value, conicity.low, conicity.high) for conicity in geometry.conicity]
        rows = [(np.nan,) * 3 if value[0] is None else value for value in values]
        value, low, high = np.array(rows, dtype=np.float64).T
        if name == SHIPPED:
            axes.fill_between(
                IN_MM * geometry.amplitude, low, high, color=colour, alpha=0.2, linewidth=0,
                label=f"{title}: 95 % interval",
            )  # fmt: skip
        axes.plot(
            IN_MM * geometry.amplitude, value, color=colour, marker=marker, markersize=4, linewidth=1.2,
            label=title,
        )  # fmt: skip
    axes.set_title(f"{study.pair}: wheelset {truth.serial}, track {TRACKS[track]}")
    axes.set_xlabel("amplitude (mm)")
    axes.set_ylabel("equivalent conicity")
    axes.grid(alpha=0.3)


def _style(order: int) -> tuple[str, str]:
    return _STYLES[order % len(_STYLES)]


def draw_errors(axes: Axes, study: PairStudy) -> None:
    """Draw every wheelset's error as a dot and the median as a bar, by information on the track; logarithmic."""
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
            transform = axes.get_xaxis_transform()
            axes.text(place, 0.5, "nothing estimated", transform=transform, ha="center", color="dimgrey", fontsize=9)
    axes.set_xlim(-0.5, len(tracks) - 0.5)
    axes.set_xticks(range(len(tracks)), [f"track\n{TRACKS[track]}" for track in tracks])
    axes.set_yscale("log")
    ticks = [1e-3, 2e-3, 5e-3, 1e-2, 2e-2, 5e-2, 0.1, 0.2, 0.5]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.set_ylabel("mean error over 1-3 mm (bar: median)")
    axes.grid(axis="y", alpha=0.3)
