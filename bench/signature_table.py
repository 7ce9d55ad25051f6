"""The rows of the signature bench."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.report import BenchRow
from bench.signature_cost import EACH, WHEELSETS
from bench.signature_foreign import KINDS as KINDS_FOREIGN
from bench.signature_pipeline import KINDS
from estimation.signatures.window_signatures import SignatureParameters

CHOSEN = (0, 1, 2, 3, 4, 5, 6, 7, 9, 10)  # seeds that the limits on roughness and tamping were chosen on
ON_FILE = {"measured": "measured profiles (std 0.003)", "estimated": "estimates (std 0.01, half of it in common)"}


def summary(cases: Sequence[Mapping[str, Any]]) -> Iterator[BenchRow]:
    """Yield the rows."""
    names = {"same": "unseen wheelsets", "other": "unseen wheelsets on unseen sections", "unplaced": "no position"}
    for kind, on_file in ON_FILE.items():
        for place, name in names.items():
            yield from rows_of(cases, kind, place, f"{name}, library of {on_file}")
    for place in ("same", "other"):
        yield _errors(_pooled(cases, "speeds", place), f"other speeds, {names[place]}: conicity")
    for kind in ON_FILE:
        yield _seen_states(cases, kind)
    for rival in cases[0]["rivals"] if cases else ():
        yield _rival_row(cases, rival)
    yield from _foreign_rows(cases)
    yield from _limit_rows(cases)
    yield from _product_rows(cases)
    yield from _cost_rows(cases)


def _pooled(cases: Sequence[Mapping[str, Any]], *keys: str) -> list[dict[str, Any]]:
    found = []
    for case in cases:
        value: Any = case
        for key in keys:
            value = value[key]
        found += value
    return found


def rows_of(cases: Sequence[Mapping[str, Any]], kind: str, place: str, name: str) -> Iterator[BenchRow]:
    """Yield classes, errors and coverage of the answers of one kind of library about one kind of place."""
    answers = _pooled(cases, kind, place)
    known = [one for one in answers if "value" in one]
    right = np.mean([one["state"] == one["condition"] for one in known])
    reach = {("measured", "same"): 0.99, ("measured", "other"): 0.95}.get((kind, place))
    yield BenchRow(
        f"{name}: seven conditions",
        f"{100 * right:.1f} % of {len(known)} right; {len(answers) - len(known)} of {len(answers)} not answered",
        "shown" if reach is None else f">= {100 * reach:.0f} %",
        reach is None or bool(right >= reach),
    )
    yield _errors(answers, f"{name}: conicity")
    covered = np.mean([one["low"] <= one["truth"] <= one["high"] for one in known])
    yield BenchRow(
        f"{name}: coverage", f"{100 * covered:.1f} % of {len(known)}", "92-98 %", bool(0.92 <= covered <= 0.98)
    )


def _errors(answers: Sequence[Mapping[str, Any]], what: str) -> BenchRow:
    errors = np.array([abs(one["value"] - one["truth"]) for one in answers if "value" in one])
    median, most = np.quantile(errors, [0.5, 0.95])
    text = (
        f"median error {median:.4f}, 95th percentile {most:.4f}; {len(answers) - len(errors)} of {len(answers)} refused"
    )
    return BenchRow(what, text, "0.05", bool(most <= 0.05))


def _seen_states(cases: Sequence[Mapping[str, Any]], kind: str) -> BenchRow:
    known = [one for one in _pooled(cases, kind, "product states") if "value" in one]
    claimed, right = (float(np.mean([one[key] for one in known])) for key in ("claimed", "right"))
    return BenchRow(
        f"probability of the most likely of the product's states, library of {ON_FILE[kind]}",
        f"claimed {100 * claimed:.1f} %, right {100 * right:.1f} % of {len(known)}",
        "within 5 %",
        abs(claimed - right) <= 0.05,
    )


def _product_rows(cases: Sequence[Mapping[str, Any]]) -> Iterator[BenchRow]:
    """Yield what comes of fleets that go through the whole product, taught by their own geometries."""
    for kind, name in KINDS.items():
        answers = [one for case in cases for one in case.get("product", {}).get(kind, [])]
        known = [one for one in answers if "value" in one]
        if not known:
            continue
        errors = np.abs([one["value"] - one["truth"] for one in known])
        covered = float(np.mean([one["low"] <= one["truth"] <= one["high"] for one in known]))
        text = (
            f"median error {np.median(errors):.4f}, 95th percentile {np.quantile(errors, 0.95):.4f};"
            f" {100 * covered:.1f} % of {len(known)} covered;"
            f" {sum(one['disagrees'] for one in known)} called different from the geometry;"
            f" {len(answers) - len(known)} of {len(answers)} refused"
        )
        yield BenchRow(f"through the product, taught by geometries: {name}", text, ">= 92 % covered", covered >= 0.92)


def _cost_rows(cases: Sequence[Mapping[str, Any]]) -> Iterator[BenchRow]:
    costs = [case["cost"] for case in cases if "cost" in case]
    if not costs:
        return
    cost = costs[0]
    yield BenchRow(
        "cost of signatures, per wheelset and hour of samples", f"{cost['signing']:.2f} CPU s", "shown", met=True
    )
    text = f"{cost['shared']:.1f} CPU s; with a library for each wheelset it would be {cost['apart']:.0f}"
    what = f"cost of judging {WHEELSETS} wheelsets with {EACH} signatures each after one new window"
    yield BenchRow(what, text, "<= 10 CPU s", cost["shared"] <= 10.0)


def _rival_row(cases: Sequence[Mapping[str, Any]], rival: str) -> BenchRow:
    parts = []
    for place in ("same", "other"):
        pairs = np.array([pair for case in cases for pair in case["rivals"][rival][place]])
        errors = np.abs(pairs[:, 1] - pairs[:, 0])
        parts.append(
            f"{place} sections: median {np.median(errors):.4f}, 95th percentile {np.quantile(errors, 0.95):.4f}"
        )
    return BenchRow(
        f"{rival} on the same features, without places; true conicities on file", "; ".join(parts), "shown", met=True
    )


def _foreign_rows(cases: Sequence[Mapping[str, Any]]) -> Iterator[BenchRow]:
    """Yield what is said of wheels and rails that the library does not have."""
    answers = _pooled(cases, "foreign")
    for kind in KINDS_FOREIGN:
        mine = [one for one in answers if one["kind"] == kind]
        known = [one for one in mine if "value" in one]
        missed = [abs(one["value"] - one["truth"]) for one in known if not one["low"] <= one["truth"] <= one["high"]]
        text = f"{len(mine) - len(known)} of {len(mine)} refused; {len(missed)} of {len(known)} answers miss the truth"
        text += f", by {max(missed):.3f} at most" if missed else ""
        yield BenchRow(f"not of the library: {kind}", text, "no answer that misses", met=not missed)


def _limit_rows(cases: Sequence[Mapping[str, Any]]) -> Iterator[BenchRow]:
    """Yield how the limits on tamping and on roughness do, on the seeds that they were chosen on and on others."""
    for name, here in (("of the seeds that chose the limit", True), ("of other seeds", False)):
        chosen = [case for case in cases if (case["seed"] in CHOSEN) == here]
        if chosen:
            yield _retired_row(chosen, name)
            yield _roughness_row(chosen, name)


def _roughness_row(cases: Sequence[Mapping[str, Any]], name: str) -> BenchRow:
    places = [_pooled(cases, kind, place) for kind in ON_FILE for place in ("other", "unplaced")]
    answers = [one for found in places for one in found]
    would = [one["would cover"] for one in answers if "would cover" in one]
    text = f"{len(would)} of {len(answers)} refused; {would.count(False)} of their intervals would have missed"
    return BenchRow(f"tracks rougher or smoother than the library's, {name}", text, "shown", met=True)


def _retired_row(cases: Sequence[Mapping[str, Any]], name: str) -> BenchRow:
    total = {key: sum(case["retired"][key] for case in cases) for key in ("worked_on", "found", "others", "false")}
    least, most = min(case["retired"]["least"] for case in cases), max(case["retired"]["most"] for case in cases)
    text = (
        f"{total['found']} of {total['worked_on']} tamped stretches found, distances from {least:.1f};"
        f" {total['false']} of {total['others']} others retired, distances to {most:.1f};"
        f" limit {SignatureParameters().largest}"
    )
    met = total["found"] >= 0.95 * total["worked_on"] and total["false"] <= 0.01 * total["others"]
    what = f"library entries of stretches tamped since, {name}"
    return BenchRow(what, text, ">= 95 % found, <= 1 % false", met)
