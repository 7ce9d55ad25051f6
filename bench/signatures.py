"""The library of wear signatures: ``python -m bench signatures [--seeds 0-2] [--write-docs] ...``.

Every seed is a fleet of its own: tracks, wheels, vehicles, sensors. Wheelsets of seven conditions teach; others, which
the library does not have, are judged from one run of 3 km each, on sections that the library has and on others. The
library has the conicity on file with the error of measured profiles, and of estimates.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from bench.results_page import markdown_table, write_page
from bench.signature_cases import CONDITIONS, Foreign, LeftTableError, Pass, Simulated, SimulatedFleet, entries
from bench.signature_cost import cost
from bench.signature_fleets import Plan, simulated
from bench.signature_pipeline import KINDS, judged_by_the_product
from bench.signature_rivals import trained
from bench.signature_table import rows_of, summary
from bench.world import seed_range
from estimation.signatures.answer import judged, most_likely
from estimation.signatures.library import Library, current, library
from estimation.signatures.window_signatures import SignatureParameters
from estimation.values.reasons import Reason
from estimation.values.signatures import ConicitySource, Signature

TITLE = "Library of wear signatures"
COLUMNS = ("what", "measured", "reach", "met")
MEASURED_STD, ESTIMATED_STD = 0.003, 0.01  # of the conicities on file: measured profiles, estimates


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 160)
    cases: list[dict[str, Any]] = json.loads(options.out.read_text()) if options.resume and options.out.exists() else []
    for seed in options.seeds:
        if all(case["seed"] != seed for case in cases):
            try:
                made = simulated(seed, options.fleets)
            except LeftTableError as error:
                console.print(f"seed {seed} is left out: {error}", highlight=False)
                continue
            cases.append(case_of(made, seed))
            if seed in options.product_seeds:
                cases[-1] |= {"product": _product_case(seed), "cost": cost(made.main)}
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
    found["foreign"] = _foreign(passes.foreign, _library(made, seed, MEASURED_STD), _parameters(made))
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
    """Return what is said of wheels and rails that the library does not have."""
    stayed = [(one.kind, one.made) for one in passes if one.made is not None]
    answers = _answers([made for _, made in stayed], known, parameters)
    left = [{"kind": one.kind, "reason": "no signatures"} for one in passes if one.made is None]
    return left + [{"kind": kind} | answer for (kind, _), answer in zip(stayed, answers, strict=True)]


def _without_place(item: Signature) -> Signature:
    return replace(item, place=None)


def _rival(made: SimulatedFleet, *, linear: bool) -> dict[str, list[tuple[float, float]]]:
    regression = trained(made.teaching, [one.wheelset.conicity for one in made.teaching], linear=linear)
    return {
        name: [(one.wheelset.conicity, regression.of(one)) for one in passes]
        for name, passes in (("same", made.same), ("other", made.other))
    }


def _retired(passes: Simulated, seed: int) -> dict[str, float]:
    """Return how many stretches of a section that was worked on are found, and of others; half of it was tamped."""
    tamped = passes.tamped
    found = current(entries(passes.retracked, np.random.default_rng([seed, 9]), MEASURED_STD), SignatureParameters())
    places = {item.place for one in passes.retracked for item in one.signatures}
    changed = {change.place for change in found.changes}
    return {
        "worked_on": len(places & tamped),
        "found": len(changed & tamped),
        "others": len(places - tamped),
        "false": len(changed - tamped),
        "least": min((one.distance for one in found.tried if one.place in tamped), default=0.0),
        "most": max((one.distance for one in found.tried if one.place not in tamped), default=0.0),
    }


def _line(case: Mapping[str, Any]) -> str:
    return "; ".join(f"{row.what}: {row.measured}" for row in rows_of([case], "measured", "same", "seen"))


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
