"""The library of wear signatures: ``python -m bench signatures [--seeds 0-2] [--write-docs] ...``.

Every seed is a fleet of its own: tracks, wheels, vehicles, sensors. Wheelsets of seven conditions teach; others, which
the library does not have, are judged from one run of 3 km each, on sections that the library has and on others. The
library has the conicity on file with the error of measured profiles, and of estimates.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.report import BenchRow
from bench.results_page import markdown_table, write_page
from bench.signature_cases import (
    CONDITIONS,
    Pass,
    Plan,
    Simulated,
    SimulatedFleet,
    entries,
    simulated,
)
from bench.signature_cost import EACH, WHEELSETS, cost
from bench.signature_pipeline import KINDS, judged_by_the_product
from bench.signature_rivals import trained
from bench.world import seed_range
from estimation.signatures.answer import judged, most_likely
from estimation.signatures.library import Library, library
from estimation.signatures.parameters import SignatureParameters
from estimation.signatures.retirement import current
from estimation.values.reasons import Reason
from estimation.values.signatures import ConicitySource, Signature

TITLE = "Library of wear signatures"
COLUMNS = ("what", "measured", "reach", "met")
ON_FILE = {"measured": "measured profiles (std 0.003)", "estimated": "estimates (std 0.01, half of it in common)"}
MEASURED_STD, ESTIMATED_STD = 0.003, 0.01  # of the conicities on file: measured profiles, estimates


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 160)
    cases: list[dict[str, Any]] = json.loads(options.out.read_text()) if options.resume and options.out.exists() else []
    for seed in options.seeds:
        if all(case["seed"] != seed for case in cases):
            cases.append(case_of(simulated(seed, options.fleets), seed))
            if seed in options.product_seeds:
                cases[-1] |= {"product": _product_case(seed), "cost": cost(simulated(seed, options.fleets).main)}
            options.out.write_text(json.dumps(cases), encoding="utf-8")
            console.print(f"seed {seed}: {_line(cases[-1])}", highlight=False)
    rows = list(summary(cases))
    cells = [(row.what, row.measured, row.reach, "yes" if row.met else "NO") for row in rows]
    table = Table(*COLUMNS, title=TITLE, title_justify="left", show_lines=True)
    for line in cells:
        table.add_row(*line)
    console.print(table)
    if options.write_docs:
        seeds = f"Seeds {', '.join(str(case['seed']) for case in cases)}."
        body = [f"{seeds} {_about()}", markdown_table(COLUMNS, cells)]
        page = write_page("signatures", TITLE, "python -m bench signatures --write-docs", body)
        console.print(f"wrote {page}", highlight=False)
    return 0 if all(row.met for row in rows) else 1


def _about() -> str:
    plan = Plan()
    return (
        f"Of each seed {plan.teachers} wheelsets run {plan.sections} sections of 3 km once each and teach;"
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
    found["profiles"] = _answers(passes.profiles, _library(made, seed, MEASURED_STD), _parameters(made))
    found["retired"] = _retired(passes, seed)
    return found


def _product_case(seed: int) -> dict[str, Any]:
    """Return what the product says of the fleets of one seed, and what it costs."""
    return {kind: judged_by_the_product(kind, seed) for kind in KINDS}


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
        signatures = one.signatures if placed else tuple(_without_place(item) for item in one.signatures)
        answer = judged(one.wheelset.serial, signatures, known, parameters)
        conicity = answer.conicity
        item: dict[str, Any] = {"condition": one.wheelset.condition, "truth": one.wheelset.conicity}
        if conicity.value is None:
            item["reason"] = str(conicity.reason)
        else:
            state = most_likely(answer.states)
            item |= {"value": conicity.value, "low": conicity.low, "high": conicity.high}
            item |= {"state": answer.states.index(state), "claimed": state.probability}
            item["right"] = state.low <= one.wheelset.conicity < state.high
        found.append(item)
    return found


def _without_place(item: Signature) -> Signature:
    return replace(item, place=None)


def _rival(made: SimulatedFleet, *, linear: bool) -> dict[str, list[tuple[float, float]]]:
    regression = trained(made.teaching, [one.wheelset.conicity for one in made.teaching], linear=linear)
    return {
        name: [(one.wheelset.conicity, regression.of(one)) for one in passes]
        for name, passes in (("same", made.same), ("other", made.other))
    }


def _retired(passes: Simulated, seed: int) -> dict[str, int]:
    """Return how many stretches of a section that was worked on are found, and of others; half of it was tamped."""
    tamped = passes.tamped
    found = current(entries(passes.retracked, np.random.default_rng([seed, 9]), MEASURED_STD))
    places = {item.place for one in passes.retracked for item in one.signatures}
    changed = {change.place for change in found.changes}
    return {
        "worked_on": len(places & tamped),
        "found": len(changed & tamped),
        "others": len(places - tamped),
        "false": len(changed - tamped),
    }


def summary(cases: Sequence[Mapping[str, Any]]) -> Iterator[BenchRow]:
    """Yield the rows."""
    names = {"same": "unseen wheelsets", "other": "unseen wheelsets on unseen sections", "unplaced": "no position"}
    for kind, on_file in ON_FILE.items():
        for place, name in names.items():
            yield from _rows_of(cases, kind, place, f"{name}, library of {on_file}")
    for place in ("same", "other"):
        yield _errors(_pooled(cases, "speeds", place), f"other speeds, {names[place]}: conicity")
    for kind in ON_FILE:
        yield _seen_states(cases, kind)
    for rival in cases[0]["rivals"] if cases else ():
        yield _rival_row(cases, rival)
    yield _profiles_row(cases)
    yield _retired_row(cases)
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


def _rows_of(cases: Sequence[Mapping[str, Any]], kind: str, place: str, name: str) -> Iterator[BenchRow]:
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
    cost = cases[-1].get("cost") if cases else None
    if cost is None:
        return
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


def _profiles_row(cases: Sequence[Mapping[str, Any]]) -> BenchRow:
    answers = _pooled(cases, "profiles")
    known = [one for one in answers if "value" in one]
    wrong = [one for one in known if not one["low"] <= one["truth"] <= one["high"]]
    text = f"{len(answers) - len(known)} of {len(answers)} refused; {len(wrong)} answers miss the truth"
    return BenchRow(
        "wheels of profiles that the library does not have (S1002 on 60E1)", text, "no answer that misses", not wrong
    )


def _retired_row(cases: Sequence[Mapping[str, Any]]) -> BenchRow:
    total = {key: sum(case["retired"][key] for case in cases) for key in ("worked_on", "found", "others", "false")}
    text = (
        f"{total['found']} of {total['worked_on']} tamped stretches found;"
        f" {total['false']} of {total['others']} others retired"
    )
    met = total["found"] >= 0.95 * total["worked_on"] and total["false"] <= 0.01 * total["others"]
    return BenchRow("library entries of stretches tamped since", text, ">= 95 % found, <= 1 % false", met)


def _line(case: Mapping[str, Any]) -> str:
    return "; ".join(f"{row.what}: {row.measured}" for row in _rows_of([case], "measured", "same", "seen"))


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench signatures", description=__doc__)
    parser.add_argument("--seeds", type=seed_range, default=[0, 1, 2], help="as in 0-19 or 3 (default: 0-2)")
    parser.add_argument("--out", type=Path, default=Path("signatures.json"))
    parser.add_argument("--product-seeds", type=seed_range, default=[0], help="those of the rows through the product")
    parser.add_argument("--fleets", type=Path, default=None, help="folder that keeps the simulated passes of each seed")
    parser.add_argument("--resume", action="store_true", help="go on with the results in --out")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/signatures.md")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
