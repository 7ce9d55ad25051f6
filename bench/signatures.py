"""The library of wear signatures: ``python -m bench signatures [--seeds 0-2] [--write-docs] ...``.

Every seed is a fleet of its own: tracks, wheels, vehicles, sensors. Wheelsets of seven conditions teach; others, which
the library does not have, are judged from one run of 3 km each, on sections that the library has and on others. The
library has the conicity on file with the error of measured profiles, and of estimates.
"""

from __future__ import annotations

import argparse
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import fields, replace
from functools import reduce
from itertools import pairwise
from operator import getitem
from typing import Any

import numpy as np

from bench.report import BenchRow, ResultTable, row_table, say
from bench.scores import Cluster, Figures, code_of, figures_table
from bench.signature_cases import CONDITIONS, Foreign, LeftTableError, Pass, Simulated, SimulatedFleet, entries
from bench.signature_fleets import KINDS_FOREIGN, Plan, simulated, trained
from bench.signature_pipeline import EACH, KINDS, WHEELSETS, cost, judged_by_the_product
from bench.study import Case, Key, Study, seeds_of
from estimation.signatures.answer import judged, most_likely
from estimation.signatures.library import Library, current, library
from estimation.signatures.window_signatures import SignatureParameters
from estimation.values.reasons import Reason
from estimation.values.signatures import ConicitySource, Signature

CHOSEN = (0, 1, 2, 3, 4, 5, 6, 7, 9, 10)  # seeds that the limits on roughness and tamping were chosen on
ON_FILE = {"measured": "measured profiles (std 0.003)", "estimated": "estimates (std 0.01, half of it in common)"}


PLACES = {"same": "unseen wheelsets", "other": "unseen wheelsets on unseen sections", "unplaced": "no position"}


def summary(cases: Sequence[Case]) -> Iterator[BenchRow]:
    """Yield the rows."""
    for kind, on_file in ON_FILE.items():
        for place, name in PLACES.items():
            yield from rows_of(cases, kind, place, f"{name}, library of {on_file}")
    for place in ("same", "other"):
        yield _errors(_pooled(cases, "speeds", place), f"other speeds, {PLACES[place]}: conicity")
    for kind in ON_FILE:
        yield _seen_states(cases, kind)
    for rival in cases[0]["rivals"] if cases else ():
        yield _rival_row(cases, rival)
    yield from _foreign_rows(cases)
    yield from _limit_rows(cases)
    yield from _product_rows(cases)
    yield from _cost_rows(cases)


def _pooled(cases: Sequence[Case], *keys: str) -> list[dict[str, Any]]:
    return [answer for case in cases for answer in reduce(getitem, keys, case)]


def rows_of(cases: Sequence[Case], kind: str, place: str, name: str) -> Iterator[BenchRow]:
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
    cover = Figures.of(_cluster(_pooled([case], kind, place)) for case in cases).cover
    yield BenchRow(f"{name}: coverage", f"{cover} of {len(known)}", "92-98 %", cover.verdict())


def _figures(cases: Sequence[Case]) -> ResultTable:
    """Return the figures of the conicities of each kind of library and place."""
    groups = [(kind, place) for kind in ON_FILE for place in PLACES]
    named = (
        (f"{PLACES[place]}, library of {ON_FILE[kind]}", [_cluster(_pooled([case], kind, place)) for case in cases])
        for kind, place in groups
    )
    return figures_table("Conicities of answers against the truth", named)


def _cluster(answers: Sequence[Case]) -> Cluster:
    """Return the conicities of the answers of a seed, whose library is one."""
    numbers = [
        (one["value"] - one["truth"], 0.5 * (one["high"] - one["low"]), one["low"] <= one["truth"] <= one["high"])
        for one in answers
        if "value" in one
    ]
    return Cluster.read(numbers, [str(one.get("code", "")) for one in answers if "value" not in one])


def _errors(answers: Sequence[Case], what: str) -> BenchRow:
    errors = np.array([abs(one["value"] - one["truth"]) for one in answers if "value" in one])
    text = f"median error {_quantiles(errors)}; {len(answers) - len(errors)} of {len(answers)} refused"
    return BenchRow(what, text, "0.05", bool(np.quantile(errors, 0.95) <= 0.05))


def _quantiles(errors: np.ndarray) -> str:
    return f"{np.median(errors):.4f}, 95th percentile {np.quantile(errors, 0.95):.4f}"


def _seen_states(cases: Sequence[Case], kind: str) -> BenchRow:
    known = [one for one in _pooled(cases, kind, "product states") if "value" in one]
    claimed, right = (float(np.mean([one[key] for one in known])) for key in ("claimed", "right"))
    return BenchRow(
        f"probability of the most likely of the product's states, library of {ON_FILE[kind]}",
        f"claimed {100 * claimed:.1f} %, right {100 * right:.1f} % of {len(known)}",
        "within 5 %",
        abs(claimed - right) <= 0.05,
    )


def _product_rows(cases: Sequence[Case]) -> Iterator[BenchRow]:
    """Yield what comes of fleets that go through the whole product, taught by their own geometries."""
    for kind, name in KINDS.items():
        answers = [one for case in cases for one in case.get("product", {}).get(kind, [])]
        known = [one for one in answers if "value" in one]
        if not known:
            continue
        errors = np.abs([one["value"] - one["truth"] for one in known])
        cover = Figures.of(_cluster(case["product"][kind]) for case in cases if "product" in case).cover
        text = (
            f"median error {_quantiles(errors)};"
            f" {cover} of {len(known)} covered;"
            f" {sum(one['disagrees'] for one in known)} called different from the geometry;"
            f" {len(answers) - len(known)} of {len(answers)} refused"
        )
        yield BenchRow(f"through the product, taught by geometries: {name}", text, "92-98 % covered", cover.verdict())


def _cost_rows(cases: Sequence[Case]) -> Iterator[BenchRow]:
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


def _rival_row(cases: Sequence[Case], rival: str) -> BenchRow:
    parts = []
    for place in ("same", "other"):
        pairs = np.array([pair for case in cases for pair in case["rivals"][rival][place]])
        errors = np.abs(pairs[:, 1] - pairs[:, 0])
        parts.append(f"{place} sections: median {_quantiles(errors)}")
    return BenchRow(
        f"{rival} on the same features, without places; true conicities on file", "; ".join(parts), "shown", met=True
    )


def _foreign_rows(cases: Sequence[Case]) -> Iterator[BenchRow]:
    answers = _pooled(cases, "foreign")
    for kind in KINDS_FOREIGN:
        mine = [one for one in answers if one["kind"] == kind]
        known = [one for one in mine if "value" in one]
        missed = [abs(one["value"] - one["truth"]) for one in known if not one["low"] <= one["truth"] <= one["high"]]
        text = f"{len(mine) - len(known)} of {len(mine)} refused; {len(missed)} of {len(known)} answers miss the truth"
        text += f", by {max(missed):.3f} at most" if missed else ""
        yield BenchRow(f"not of the library: {kind}", text, "no answer that misses", met=not missed)


def _limit_rows(cases: Sequence[Case]) -> Iterator[BenchRow]:
    """Yield how the limits on tamping and on roughness do, on the seeds that they were chosen on and on others."""
    for name, here in (("of the seeds that chose the limit", True), ("of other seeds", False)):
        chosen = [case for case in cases if (case["seed"] in CHOSEN) == here]
        if chosen:
            yield _retired_row(chosen, name)
            yield _roughness_row(chosen, name)


def _roughness_row(cases: Sequence[Case], name: str) -> BenchRow:
    places = [_pooled(cases, kind, place) for kind in ON_FILE for place in ("other", "unplaced")]
    answers = [one for found in places for one in found]
    would = [one["would cover"] for one in answers if "would cover" in one]
    text = f"{len(would)} of {len(answers)} refused; {would.count(False)} of their intervals would have missed"
    return BenchRow(f"tracks rougher or smoother than the library's, {name}", text, "shown", met=True)


def _retired_row(cases: Sequence[Case], name: str) -> BenchRow:
    total = {key: sum(case["retired"][key] for case in cases) for key in ("worked_on", "found", "others", "false")}
    least, most = min(case["retired"]["least"] for case in cases), max(case["retired"]["most"] for case in cases)
    text = (
        f"{total['found']} of {total['worked_on']} tamped stretches found, distances from {least:.1f};"
        f" {total['false']} of {total['others']} others retired, distances to {most:.1f}; limit"
        f" {SignatureParameters().largest_distance}"
    )
    met = total["found"] >= 0.95 * total["worked_on"] and total["false"] <= 0.01 * total["others"]
    what = f"library entries of stretches tamped since, {name}"
    return BenchRow(what, text, ">= 95 % found, <= 1 % false", met)


MEASURED_STD, ESTIMATED_STD = 0.003, 0.01  # of the conicities on file: measured profiles, estimates


def _about(cases: Sequence[Case]) -> str:
    plan = Plan()
    return (
        f"Seeds {', '.join(str(case['seed']) for case in cases)}. Of each seed {plan.teachers} wheelsets run"
        f" {plan.sections} sections of 3 km once each and teach;"
        f" {plan.judged} others are judged from one run each, over {plan.others} of these sections and over"
        f" {plan.others} that the library does not have. Seven conditions: P8 wheels with {CONDITIONS[0] * 1e3:g} to"
        f" {CONDITIONS[-1] * 1e3:g} mm of tread worn away on new 56E1 rails, in steps of {CONDITIONS[1] * 1e3:g} mm;"
        " 14 to 20 m/s; single wheelsets whose parameters differ from their class by up to 6 % (std); MEMS sensors;"
        " positions off by 10 m (std); sections of 1.2 to 2.4 mm of alignment (std)."
    )


def case_of(passes: Simulated, seed: int) -> dict[str, Any]:
    """Return what one seed gave."""
    made = passes.main
    found: dict[str, Any] = {"seed": seed}
    for name, std in (("measured", MEASURED_STD), ("estimated", ESTIMATED_STD)):
        known = _library(made, seed, std)
        parameters = _parameters(made)
        found[name] = {
            "same": _answers(made.same, known, parameters),
            "other": _answers(made.other, known, parameters),
            "unplaced": _answers((*made.same, *made.other), known, parameters, placed=False),
            "product states": _answers((*made.same, *made.other), known, SignatureParameters()),
        }
    found["rivals"] = {name: _rival(made, linear=name == "ridge") for name in ("ridge", "Gaussian process")}
    speeds = passes.speeds
    found["speeds"] = {
        name: _answers(passes, _library(speeds, seed, MEASURED_STD), _parameters(speeds))
        for name, passes in (("same", speeds.same), ("other", speeds.other))
    }
    found["foreign"] = _foreign(passes.foreign, _library(made, seed, MEASURED_STD), _parameters(made))
    found["retired"] = _retired(passes, seed)
    return found


def _library(made: SimulatedFleet, seed: int, std: float) -> Library:
    source = ConicitySource.MEASURED_PROFILES if std == MEASURED_STD else ConicitySource.GEOMETRY
    known = entries(made.teaching, np.random.default_rng([seed, 9]), std, source)
    found = library(known, _parameters(made))
    if isinstance(found, Reason):
        raise RuntimeError(found.text)  # noqa: TRY004 - a reason is a finding, not a wrong type
    return found


def _parameters(made: SimulatedFleet) -> SignatureParameters:
    """Return the parameters with states that part the seven conditions half way."""
    kinds = [
        np.mean([one.wheelset.conicity for one in made.teaching if one.wheelset.condition == condition])
        for condition in range(len(CONDITIONS))
    ]
    ends = tuple(0.5 * float(low + high) for low, high in pairwise(kinds))
    return replace(SignatureParameters(), states=ends)


def _answers(
    passes: Iterable[Pass], known: Library, parameters: SignatureParameters, *, placed: bool = True
) -> list[dict[str, Any]]:
    found = []
    for one in passes:
        signatures = one.signatures if placed else tuple(replace(item, place=None) for item in one.signatures)
        answer = judged(one.wheelset.serial, signatures, known, parameters)
        conicity = answer.conicity
        item: dict[str, Any] = {"condition": one.wheelset.condition, "truth": one.wheelset.conicity}
        if conicity.value is None:
            item["reason"], item["code"] = str(conicity.reason), code_of(conicity)
            item |= _of_any_track(one, signatures, known, parameters) if "than any that" in item["reason"] else {}
        else:
            state = most_likely(answer.states)
            item |= {"value": conicity.value, "low": conicity.low, "high": conicity.high}
            item |= {"state": answer.states.index(state), "claimed": state.probability}
            item["right"] = state.low <= one.wheelset.conicity < state.high
        found.append(item)
    return found


class _OfAnyTrack(Library):
    """A library that does not refuse tracks rougher or smoother than its own."""

    __slots__ = ()

    def levels(self, places: int) -> tuple[float, float]:
        del places
        return -float("inf"), float("inf")


def _of_any_track(
    one: Pass, signatures: Sequence[Signature], known: Library, parameters: SignatureParameters
) -> dict[str, bool]:
    """Return whether the interval would cover where an answer is refused for the roughness of the track."""
    of = _OfAnyTrack(*(getattr(known, field.name) for field in fields(known)))
    found = judged(one.wheelset.serial, signatures, of, parameters).conicity
    if found.low is None or found.high is None:
        return {}
    return {"would cover": found.low <= one.wheelset.conicity <= found.high}


def _foreign(passes: Sequence[Foreign], known: Library, parameters: SignatureParameters) -> list[dict[str, Any]]:
    stayed = [(one.kind, one.made) for one in passes if one.made is not None]
    answers = _answers([made for _, made in stayed], known, parameters)
    left = [{"kind": one.kind, "reason": "no signatures"} for one in passes if one.made is None]
    return left + [{"kind": kind} | answer for (kind, _), answer in zip(stayed, answers, strict=True)]


def _rival(made: SimulatedFleet, *, linear: bool) -> dict[str, list[tuple[float, float]]]:
    regression = trained(made.teaching, [one.wheelset.conicity for one in made.teaching], linear=linear)
    return {
        name: [(one.wheelset.conicity, regression.of(one)) for one in passes]
        for name, passes in (("same", made.same), ("other", made.other))
    }


def _retired(passes: Simulated, seed: int) -> dict[str, float]:
    """Return how many stretches of a section that was worked on are found, and of others; half of it was tamped."""
    tamped, limit = passes.tamped, SignatureParameters().largest_distance
    known = entries(passes.retracked, np.random.default_rng([seed, 9]), MEASURED_STD)
    tried = current(known, replace(SignatureParameters(), largest_distance=0.0)).changes
    places = {item.place for one in passes.retracked for item in one.signatures}
    changed = {one.place for one in tried if one.distance > limit}
    return {
        "worked_on": len(places & tamped),
        "found": len(changed & tamped),
        "others": len(places - tamped),
        "false": len(changed - tamped),
        "least": min((one.distance for one in tried if one.place in tamped), default=0.0),
        "most": max((one.distance for one in tried if one.place not in tamped), default=0.0),
    }


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case]:
    for seed in options.seeds:
        if (seed,) in done:
            continue
        try:
            made = simulated(seed)
        except LeftTableError as error:
            say(f"seed {seed} is left out: {error}")
            continue
        case = case_of(made, seed)
        if seed in options.product_seeds:
            case["product"] = {kind: judged_by_the_product(kind, seed) for kind in KINDS}
            case["cost"] = cost(made.main)
        yield case


def _line(case: Case) -> str:
    rows = "; ".join(f"{row.what}: {row.measured}" for row in rows_of([case], "measured", "same", "seen"))
    return f"seed {case['seed']}: {rows}"


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--product-seeds", type=seeds_of, default=[0], help="those of the rows through the product")


main = Study(
    name="signatures",
    title="Library of wear signatures",
    about=__doc__ or "",
    cases=_cases,
    parts=lambda cases: [_about(cases), row_table(summary(cases)), _figures(cases)],
    line=_line,
    seeds="0-2",
    key=("seed",),
    options=_options,
).run
