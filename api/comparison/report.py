"""The comparison as a table, as words computed from it, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.table import Table

from api.comparison.study import PairStudy, Score, Told
from estimation.alerts import JsonValue
from estimation.estimators.catalogue import PRODUCT, estimators

TOLD = {
    Told.KNOWN: "known",
    Told.FLEET: "from the fleet",
    Told.NOTHING: "not known (d = 0)",
}
LEAST_ESTIMATED = 0.5  # share of the amplitudes that an estimator must estimate to win anything


def titles() -> dict[str, str]:
    """Return what the estimators are, by name."""
    return {item.name: item.title for item in estimators()}


def table(studies: Sequence[PairStudy]) -> Table:
    """Return who gets how near, for a terminal."""
    shown = Table(
        "pair", "track", "estimator", "median", "95th", "cover", "given", "s",
        title="Equivalent conicity: mean absolute error over 1-3 mm per wheelset, median and 95th percentile;\n"
        "share of intervals that cover, of amplitudes that are given; seconds for all wheelsets",
        title_justify="left",
    )  # fmt: skip
    for study in studies:
        for score in study.scores:
            shown.add_row(
                score.pair,
                TOLD[score.told],
                score.estimator,
                _figure(score.median),
                _figure(score.p95),
                _share(score.coverage),
                _share(score.estimated / score.amplitudes if score.amplitudes else math.nan),
                f"{score.seconds:.1f}",
            )
        shown.add_section()
    return shown


def markdown(studies: Sequence[PairStudy]) -> str:
    """Return the same as a Markdown table."""
    head = ("pair", "track", "estimator", "median", "95th percentile", "intervals that cover", "estimated", "seconds")
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * 3 + " ---: |" * (len(head) - 3)]
    named = titles()
    for study in studies:
        for score in study.scores:
            estimated = score.estimated / score.amplitudes if score.amplitudes else math.nan
            cells = (
                score.pair, TOLD[score.told], named[score.estimator], _figure(score.median), _figure(score.p95),
                _share(score.coverage), _share(estimated), f"{score.seconds:.1f}",
            )  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def words(studies: Sequence[PairStudy]) -> list[str]:
    """Return one sentence for each pair and each thing told: who comes nearest, and by how much."""
    said = []
    for study in studies:
        for told in Told:
            if told in study.untold:
                said.append(f"{study.pair}, track {TOLD[told]}: nothing can be told: {study.untold[told]}.")
                continue
            said.append(_winner(study.pair, told, [score for score in study.scores if score.told is told]))
    return said


def as_json(studies: Sequence[PairStudy], scenario: str) -> dict[str, JsonValue]:
    """Return every figure; null where there is none."""
    return {
        "scenario": scenario,
        "pairs": [
            {
                "pair": study.pair,
                "seed": study.seed,
                "track_seconds": round(study.track_seconds, 3),
                "untold": {told.value: reason for told, reason in study.untold.items()},
                "scores": [_score(score) for score in study.scores],
            }
            for study in studies
        ],
        "words": list(words(studies)),
    }


def _winner(pair: str, told: Told, scores: Sequence[Score]) -> str:
    named, where = titles(), f"{pair}, track {TOLD[told]}"
    fit = [score for score in scores if score.errors and score.estimated >= LEAST_ESTIMATED * score.amplitudes]
    if not fit:
        return f"{where}: no estimator estimates half of the amplitudes."
    order = sorted(fit, key=lambda score: score.p95)
    best = order[0]
    product = next((score for score in fit if score.estimator == PRODUCT), None)
    figures = f"95th percentile {best.p95:.4f}, median {best.median:.4f}"
    if best is product:
        if len(order) == 1:
            return f"{where}: {named[PRODUCT]} alone estimates half of the amplitudes ({figures})."
        second = order[1]
        return f"{where}: {named[PRODUCT]} win ({figures}); {named[second.estimator]} follows with {second.p95:.4f}."
    if product is None:
        return f"{where}: a baseline wins, {named[best.estimator]} ({figures}); {named[PRODUCT]} estimate too little."
    return (
        f"{where}: a baseline wins, {named[best.estimator]} ({figures}); "
        f"{named[PRODUCT]} reach {product.p95:.4f}, median {product.median:.4f}."
    )


def _score(score: Score) -> dict[str, JsonValue]:
    return {
        "track": score.told.value,
        "estimator": score.estimator,
        "median_error": _number(score.median),
        "p95_error": _number(score.p95),
        "coverage": _number(score.coverage),
        "amplitudes": score.amplitudes,
        "estimated": score.estimated,
        "wheelsets": score.wheelsets,
        "seconds": round(score.seconds, 3),
        "errors": [round(error, 6) for error in score.errors],
    }


def _number(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None


def _figure(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else "-"


def _share(value: float) -> str:
    return f"{value:.0%}" if math.isfinite(value) else "-"
