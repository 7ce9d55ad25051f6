"""The comparison as a table, as sentences computed from it, and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence

from rich.table import Table

from api.comparison.study import PairStudy, Score, TrackInformation
from estimation.estimators.catalogue import SHIPPED, estimators
from estimation.values.fields import JsonValue

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
        won = nearest(study)
        for score in study.scores:
            shown.add_row(
                score.pair,
                TRACKS[score.track],
                score.estimator,
                _figure(score.median),
                _figure(score.p95),
                str(won[score.track, score.estimator]),
                _share(score.coverage),
                _share(score.estimated / score.amplitudes if score.amplitudes else math.nan),
                f"{score.seconds:.1f}",
            )
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
    for study in studies:
        won = nearest(study)
        for score in study.scores:
            estimated = score.estimated / score.amplitudes if score.amplitudes else math.nan
            cells = (
                score.pair, TRACKS[score.track], named[score.estimator], _figure(score.median), _figure(score.p95),
                str(won[score.track, score.estimator]), _share(score.coverage), _share(estimated),
                f"{score.seconds:.1f}",
            )  # fmt: skip
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def nearest(study: PairStudy) -> dict[tuple[TrackInformation, str], int]:
    """Return for how many wheelsets each estimator has the least error, by information on the track."""
    found = {(score.track, score.estimator): 0 for score in study.scores}
    for track in TrackInformation:
        scores = [score for score in study.scores if score.track is track]
        for k in range(max((len(score.by_wheelset) for score in scores), default=0)):
            errors = {score.estimator: score.by_wheelset[k] for score in scores if math.isfinite(score.by_wheelset[k])}
            if errors:
                found[track, min(errors, key=errors.__getitem__)] += 1
    return found


def sentences_of(studies: Sequence[PairStudy]) -> list[str]:
    """Return one sentence for each pair and information on the track: the most accurate estimator, by how much."""
    sentences = []
    for study in studies:
        for track in TrackInformation:
            if track in study.unestimated:
                sentences.append(
                    f"{study.pair}, track {TRACKS[track]}: nothing is estimated: {study.unestimated[track]}."
                )
                continue
            sentences.append(_winner(study, track))
    return sentences


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
                "scores": [_score(score) for score in study.scores],
            }
            for study in studies
        ],
        "sentences": list(sentences_of(studies)),
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


def _score(score: Score) -> dict[str, JsonValue]:
    return {
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


def _number(value: float) -> float | None:
    return round(value, 6) if math.isfinite(value) else None


def _figure(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else "-"


def _share(value: float) -> str:
    return f"{value:.0%}" if math.isfinite(value) else "-"
