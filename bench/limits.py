"""Alerts at the conicity limit: ``python -m bench limits [--shapes N] [--wheelsets N] [--seeds 31-34] ...``.

Worn wheelsets of shapes that the extrapolation does not hold run over irregular track; those that cover 1.5 to 2.25 mm
live for some intervals and are judged by the real trend and the real rules. Beside them the rule before, in the same
run: the smooth trend at 3 mm alone. All wheelsets of a seed run on tracks of one shape, and those of one curve are
raised, or not, together: several seeds decide.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np

from bench.limits_lives import Judged, Worn, judged, limit_at
from bench.limits_running import amplitude_reached
from bench.limits_shapes import CLASSES, curve_of
from bench.report import BenchRow, printed
from bench.results_page import ended
from bench.world import seed_range
from bench.worn_family import AMPLITUDES, DISPLACEMENT
from estimation.contact.conicity import equivalent_conicity

TITLE = "Alerts at the conicity limit"
SHAPES, WHEELSETS, SEEDS = 300, 850, (11,)
IRREGULARITIES = (0.4e-3, 0.55e-3, 0.7e-3, 0.9e-3, 1.2e-3)  # m
YAW_SPRINGS = (0.15, 0.6)  # kappa, 1/m
SPEEDS = tuple(v / 3.6 for v in (120.0, 160.0, 200.0, 250.0, 300.0))  # with limits of 0.40 to 0.20
LEAST, MOST = 0.05, 0.8  # conicity at 3 mm
COVERED = (1.5e-3, 2.25e-3)  # m
ASKED = (1.75e-3, 2.0e-3)  # m
MARGIN = 0.03
BEYOND_SHARE = 0.7  # of the wheelsets: beyond the limit, the others below it
BANDS = ((0.03, 0.1), (0.1, 0.2), (0.2, 1.0))


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    parser = argparse.ArgumentParser(prog="python -m bench limits", description=__doc__)
    parser.add_argument("--shapes", type=int, default=SHAPES, help="drawn of each class")
    parser.add_argument("--wheelsets", type=int, default=WHEELSETS, help="of a seed that are judged, at most")
    parser.add_argument("--seeds", type=seed_range, default=list(SEEDS), help="as in 31-34 or 3")
    parser.add_argument("--write-docs", action="store_true")
    options = parser.parse_args(arguments)
    found = []
    for seed in options.seeds:
        found += [judged(worn) for worn in worn_wheelsets(options.shapes, options.wheelsets, seed)]
        sys.stderr.write(f"seed {seed}: {len(found)} wheelsets judged\n")
    seeds = f"{min(options.seeds)}-{max(options.seeds)}"
    command = f"python -m bench limits --shapes {options.shapes} --wheelsets {options.wheelsets} --seeds {seeds}"
    return ended(printed(rows(found)), "limits", TITLE, f"{command} --write-docs" if options.write_docs else None)


def worn_wheelsets(shapes: int, most: int, seed: int) -> list[Worn]:
    """Return worn wheelsets that cover less than 3 mm, each on some track under a vehicle of some speed.

    Args:
        most: How many wheelsets are returned at most.
        seed: Of all that is drawn.
    """
    random = np.random.default_rng(seed)
    drawn = [(kind, curve_of(kind, random)) for _, kind in product(range(shapes), CLASSES)]
    kinds, curves = zip(*[(kind, curve) for kind, curve in drawn if curve is not None], strict=True)
    conicity = np.stack([equivalent_conicity(DISPLACEMENT, curve, AMPLITUDES) for curve in curves])
    with np.errstate(invalid="ignore"):
        usual = np.flatnonzero((conicity[:, -1] > LEAST) & (conicity[:, -1] < MOST) & np.isfinite(conicity).all(axis=1))
    of_shape, on_track = (np.array(one) for one in zip(*product(usual, IRREGULARITIES), strict=True))
    springs = random.uniform(*YAW_SPRINGS, len(of_shape))
    reached = amplitude_reached(np.stack(curves)[of_shape], on_track, springs, seed)
    covered = np.floor(reached / 0.25e-3 + 1e-9) * 0.25e-3
    kept = np.flatnonzero((covered >= COVERED[0] - 1e-9) & (covered <= COVERED[1] + 1e-9))
    every = [
        Worn(kinds[of_shape[i]], conicity[of_shape[i]], float(covered[i]), speed, int(i) * len(SPEEDS) + k)
        for i, (k, speed) in product(kept, enumerate(SPEEDS))
    ]
    beyond = [one for one in every if one.above >= MARGIN]
    below = [one for one in every if one.above <= -MARGIN]
    shares = ((beyond, round(BEYOND_SHARE * most)), (below, most - round(BEYOND_SHARE * most)))
    return [group[int(i)] for group, count in shares for i in random.permutation(len(group))[:count]]


def rows(found: Sequence[Judged]) -> Iterator[BenchRow]:
    """Yield the rows of the table."""
    asked = [one for one in found if ASKED[0] - 1e-9 <= one.worn.covered <= ASKED[1] + 1e-9]
    beyond = [one for one in asked if one.worn.above >= MARGIN]
    raised, over = _share(beyond, lambda one: one.over or one.measure), _share(beyond, lambda one: one.over)
    yield BenchRow(
        f"beyond the limit by {MARGIN:g} or more at 3 mm, 1.75 or 2 mm covered, {_size(beyond)}: raised",
        f"{raised:.1%} (`conicity_limit` {over:.1%}); {_former(beyond)}",
        "98 % or more",
        raised >= 0.98,
    )
    share = over / raised if raised else 0.0
    yield BenchRow("of those raised: `conicity_limit`", f"{share:.1%}", "60 % or more", share >= 0.6)
    below = [one for one in found if one.worn.above <= -MARGIN]
    quiet = [one for one in below if one.worn.above_reached <= 0.0]
    for name, group in (("at 3 mm", below), ("at 3 mm and at or below it at the amplitude reached", quiet)):
        false = _share(group, lambda one: one.over)
        yield BenchRow(
            f"below the limit by {MARGIN:g} or more {name}, {_size(group)}: `conicity_limit`",
            f"{false:.2%}; {_former(group)}",
            "1 % or less",
            false <= 0.01,
        )
    yield from _for_information(found)


def _for_information(found: Sequence[Judged]) -> Iterator[BenchRow]:
    for covered in (1.5e-3, 1.75e-3, 2e-3, 2.25e-3):
        group = [one for one in found if one.worn.above >= MARGIN and abs(one.worn.covered - covered) < 1e-6]
        yield from _counted(f"beyond by {MARGIN:g} or more, {1e3 * covered:g} mm covered", group)
    for kind in CLASSES:
        group = [one for one in found if one.worn.above >= MARGIN and one.worn.kind == kind]
        yield from _counted(f"beyond by {MARGIN:g} or more, {kind}", group)
    for low, high in BANDS:
        group = [one for one in found if low <= one.worn.above < high]
        yield from _counted(f"beyond by {low:g} to {high:g}", group)
    for low, high in BANDS:
        group = [one for one in found if low <= -one.worn.above < high]
        yield from _counted(f"below by {low:g} to {high:g}", group)
    for speed in SPEEDS:
        far = [one for one in found if one.worn.speed == speed and one.worn.conicity[-1] < 0.5 * limit_at(speed)]
        yield from _counted(f"below half of a limit of {limit_at(speed):.3f}", far)


def _counted(name: str, group: Sequence[Judged]) -> Iterator[BenchRow]:
    if group:
        text = f"`conicity_limit` {_share(group, lambda one: one.over):.1%}, `measure`"
        text += f" {_share(group, lambda one: one.measure and not one.over):.1%}; {_former(group)}"
        yield BenchRow(f"{name}, {len(group)} wheelsets", text, "for information", True)  # noqa: FBT003 - nothing to be reached


def _size(group: Sequence[Judged]) -> str:
    """Return how many wheelsets of how many shapes: those of one shape are raised, or not, together."""
    return f"{len(group)} wheelsets of {len({one.worn.conicity.tobytes() for one in group})} shapes"


def _former(group: Sequence[Judged]) -> str:
    return f"rule before {_share(group, lambda one: one.former):.1%}"


def _share(group: Sequence[Judged], holds: Callable[[Judged], bool]) -> float:
    return float(np.mean([holds(one) for one in group])) if group else 0.0
