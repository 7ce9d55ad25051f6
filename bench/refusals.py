"""Right vehicles that are refused, and wrong ones that are not: ``python -m bench refusals [--seeds 0-199] ...``.

Every seed draws a vehicle over sensors, vibration, profiles, speed, arrangement, track and survey and judges it as it
is, every third one also wrong in several ways (``refusals_case``), by the functions that the jobs call. A quick look is
``--seeds 0-29``; the figures that decide take 300 wheelsets.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from bench.refusals_case import IN_BOGIES, OnFile, drawn_case, judged, simulated
from bench.report import Part, ResultTable
from bench.scores import AMPLITUDES, Cluster
from bench.study import Case, Key, Study
from estimation.errors import TreadwatchError
from estimation.geometry.rolling_radius import ROLLING
from estimation.values.reasons import ReasonCode

RIGHT = "right"
SKIPPED = "skipped"
RADIUS_OPEN = str(ReasonCode.ROLLING_RADIUS_OPEN)
MOST_WITHHELD, MOST_IN_A_ROW = 0.01, 0.03  # share of the right wheelsets
LEAST_FOUND = 0.99  # share of the wrong ones
HEADER = ("row", "wheelsets", "withheld", "in doubt", "codes", "error: median / 95 %", "covers", "reach", "met")
WRONG_HEADER = (
    "wrong", "wheelsets", "withheld", "in doubt", "found", "moved", "covers", "error where published as good", "reach",
    "met",
)  # fmt: skip
RADIUS_HEADER = ("track, sensors", "wheelsets", "error: median / 68 %", "stated std", "std by noise alone", "open")
WRONG_TITLE = "Wrong on file, or of the nodes"
WRONG_EXPLANATION = (
    "In doubt is also what a survey of 1 mm leaves open; a radius that is open is a doubt on a radius alone. *Moved* is"
    " by how much the published conicity is another one than with the right file, *covers* the share of its intervals"
    " that hold the truth."
)
INTERVAL_HEADER = ("sensors, m/s", "wheelsets", "conicities of nine", "error: median / 95 %", "covers")
INTERVAL_TITLE = "Intervals by sensors and speed, where the file is right"
INTERVAL_EXPLANATION = (
    "The noise of a sensor is integrated: the slower the vehicle, the less is known of its lateral displacement."
)
RADIUS_TITLE = "The radius that the motion has, where the file is right"
RADIUS_EXPLANATION = (
    "In percent of the radius; 68 % of the errors are below the second one. *Std by noise alone* is the bound of Cramer"
    " and Rao for the same sums with the noise"
    " that is left in them; the stated std also holds what the equation lacks. *Open* are those whose std does not"
    " leave out a mistake of 10 %."
)
EXPLANATION = (
    "Each seed draws arrangement, sensors, vibration of the axle boxes (m/s2 rms), profiles, speed (m/s), track and std"
    " of the survey (mm); 6 windows a wheelset. *Withheld* is a wheelset of which nothing is published for what its"
    " data contradict; *in doubt* one of which a number is published, with the doubt beside it, wider but for an open"
    " radius. Errors"
    " and intervals are those of the equivalent conicity over 1-3 mm."
)


def summary_rows(found: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return a line for all right wheelsets, and one for each kind of each dimension."""
    return [_summary(name, of_row, limit) for name, of_row, limit in _groups(found)]


def wrong_rows(found: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return a line for each kind of mistake."""
    kinds = dict.fromkeys(one["kind"] for one in found if one["kind"] not in (RIGHT, SKIPPED))
    right = {(one["seed"], one["axle"]): one["values"] for one in found if one["kind"] == RIGHT}
    return [_wrong(kind, [one for one in found if one["kind"] == kind], right) for kind in kinds]


def interval_rows(found: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return how many conicities of right wheelsets are published and right, by sensors and speed."""
    right = [wheelset for wheelset in found if wheelset["kind"] == RIGHT]
    return [_intervals(name, of_row) for name, of_row in _by_draw(right, "sensors", "speed")]


def radius_rows(found: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return what the motion shows of the radius of right wheelsets, by track and sensors."""
    right = [wheelset for wheelset in found if wheelset["kind"] == RIGHT and wheelset["radius"] is not None]
    return [_radius(name, of_row) for name, of_row in _by_draw(right, "track", "sensors")]


def _by_draw(wheelsets: Sequence[Case], first: str, second: str) -> list[tuple[str, list[Case]]]:
    """Return wheelsets by two of the things that were drawn, in the order of their names."""
    groups: dict[str, list[Case]] = {}
    for wheelset in wheelsets:
        groups.setdefault(f"{wheelset['drawn'][first]}, {wheelset['drawn'][second]}", []).append(wheelset)
    return sorted(groups.items())


def parts(found: Sequence[Case]) -> list[Part]:
    """Return the page of results."""
    skipped = sum(one["kind"] == SKIPPED for one in found)
    judged_wrong = len({one["seed"] for one in found if one["kind"] not in (RIGHT, SKIPPED)})
    return [
        EXPLANATION,
        f"{skipped} seeds are left out: their wheelsets hunt until they derail.",
        ResultTable(HEADER, summary_rows(found), range(1, 4)),
        f"{WRONG_TITLE}: {judged_wrong} of the seeds. {WRONG_EXPLANATION}",
        ResultTable(WRONG_HEADER, wrong_rows(found), range(1, 6)),
        f"{INTERVAL_TITLE}. {INTERVAL_EXPLANATION}",
        ResultTable(INTERVAL_HEADER, interval_rows(found), range(1, 5)),
        f"{RADIUS_TITLE}. {RADIUS_EXPLANATION}",
        ResultTable(RADIUS_HEADER, radius_rows(found), range(1, 6)),
    ]


def _groups(found: Sequence[Case]) -> Iterator[tuple[str, list[Case], float]]:
    right = [one for one in found if one["kind"] == RIGHT]
    yield "all", right, MOST_WITHHELD
    names = right[0]["drawn"] if right else {}
    for name in names:
        for kind in sorted({one["drawn"][name] for one in right}):
            yield f"{name}: {kind}", [one for one in right if one["drawn"][name] == kind], MOST_IN_A_ROW


def _summary(name: str, of_row: Sequence[Case], limit: float) -> tuple[str, ...]:
    withheld = sum(one["withheld"] for one in of_row)
    codes = Counter(one["code"] for one in of_row if one["withheld"] or one["doubted"])
    covered = [held for one in of_row for held in one["covered"]]
    return (
        name,
        str(len(of_row)),
        str(withheld),
        str(sum(one["doubted"] for one in of_row)),
        ", ".join(f"{code} {count}" for code, count in codes.most_common()),
        _error(of_row),
        f"{np.mean(covered):.0%}".replace("%", " %") if covered else "",
        f"{limit:.0%}".replace("%", " %"),
        "yes" if of_row and withheld <= limit * len(of_row) else "NO",
    )


def _wrong(
    kind: str, of_kind: Sequence[Case], right: Mapping[tuple[int, int], Sequence[float | None]]
) -> tuple[str, ...]:
    withheld, doubted = sum(one["withheld"] for one in of_kind), sum(_doubted(one) for one in of_kind)
    silent = sum(not one["published"] and not one["withheld"] for one in of_kind)
    share = (withheld + doubted + silent) / len(of_kind)
    good = [one for one in of_kind if one["published"] and not _doubted(one)]
    covered = [held for one in of_kind for held in one["covered"]]
    return (
        kind,
        str(len(of_kind)),
        str(withheld + silent),
        str(doubted),
        f"{share:.0%}".replace("%", " %"),
        _moved(of_kind, right),
        f"{np.mean(covered):.0%}".replace("%", " %") if covered else "",
        _error(good),
        f"{LEAST_FOUND:.0%}".replace("%", " %"),
        "yes" if share >= LEAST_FOUND else "NO",
    )


def _doubted(one: Case) -> bool:
    """Whether a doubt stands beside the number that may be about what is wrong."""
    return bool(one["doubted"]) and (one["code"] != RADIUS_OPEN or one["kind"].startswith("radius"))


def _moved(of_kind: Sequence[Case], right: Mapping[tuple[int, int], Sequence[float | None]]) -> str:
    """Return by how much conicities are others than with the right file, in the median."""
    moved = []
    for one in of_kind:
        before = right.get((one["seed"], one["axle"]), ())
        pairs = zip(one["values"], before, strict=True) if one["values"] and before else ()
        moved += [now / then - 1.0 for now, then in pairs if now is not None and then is not None]
    return f"{np.median(moved):+.0%}".replace("%", " %") if moved else ""


def _intervals(name: str, of_row: Sequence[Case]) -> tuple[str, ...]:
    covered = [held for one in of_row for held in one["covered"]]
    share = f"{np.mean(covered):.1%}".replace("%", " %") if covered else ""
    return name, str(len(of_row)), f"{len(covered) / len(of_row):.1f}", _error(of_row), share


def _radius(name: str, of_row: Sequence[Case]) -> tuple[str, ...]:
    error, std, bound = 100.0 * np.array([one["radius"] for one in of_row]).T
    return (
        name,
        str(len(of_row)),
        f"{np.median(error):+.1f} / {np.percentile(np.abs(error), 68):.1f}",
        f"{np.median(std):.1f}",
        f"{np.median(bound):.1f}",
        str(int(np.sum(np.abs(error) + ROLLING.doubted_stds * std > 100.0 * ROLLING.radius_mistake))),
    )


def _error(of_row: Sequence[Case]) -> str:
    errors = [float(np.mean(np.abs(one["errors"]))) for one in of_row if one["errors"]]
    return f"{np.median(errors):.4f} / {np.percentile(errors, 95):.4f}" if errors else "none"


CAMPAIGNS = 3  # of two minutes: 6 windows
WRONG_EVERY = 3  # seeds that are also judged wrong on file: right ones are more, and cheaper


def run_seed(seed: int, campaigns: int, wrong_every: int) -> list[dict[str, Any]]:
    """Return what is said of the wheelsets of a seed, right and, every ``wrong_every`` seeds, also wrong on file."""
    try:
        case = simulated(seed, campaigns)
    except TreadwatchError:
        return [{"seed": seed, "kind": SKIPPED, "drawn": drawn_case(seed)}]
    in_bogie = case.vehicle_class.bogie is not None
    return [
        {
            "seed": seed,
            "kind": str(kind),
            "drawn": dict(case.drawn),
            "axle": axle,
            "withheld": one.withheld,
            "doubted": one.doubted,
        }
        | asdict(one)
        for kind in OnFile
        if kind is OnFile.RIGHT or (seed % wrong_every == 0 and (in_bogie or kind not in IN_BOGIES))
        for axle, one in enumerate(judged(case, kind))
    ]


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case]:
    for seed in options.seeds:
        if (seed,) not in done:
            yield {"seed": seed, "wheelsets": run_seed(seed, CAMPAIGNS, WRONG_EVERY)}


def _published(case: Case) -> Cluster:
    """Return the conicities of the right wheelsets of a seed, which share a track."""
    right = [item for item in case["wheelsets"] if item["kind"] == RIGHT]
    numbers = [number for item in right for number in item["found"]]
    return Cluster.read(numbers, [item["code"] for item in right if not item["published"] for _ in AMPLITUDES])


def _line(case: Case) -> str:
    said = [f"{one['kind']}: {one['code'] or 'good'}" for one in case["wheelsets"] if one["kind"] != SKIPPED]
    drawn = case["wheelsets"][0]["drawn"].values()
    return f"seed {case['seed']}: {', '.join(drawn)}; {', '.join(said) or SKIPPED}"


def _command(cases: Sequence[Case]) -> str:
    seeds = [case["seed"] for case in cases]
    return f"python -m bench refusals --seeds {min(seeds)}-{max(seeds)} --write-docs"


main = Study(
    name="refusals",
    title="Right vehicles that are refused, wrong ones that are not",
    about=__doc__ or "",
    cases=_cases,
    parts=lambda cases: parts([one for case in cases for one in case["wheelsets"]]),
    line=_line,
    published=_published,
    seeds="0-29",
    key=("seed",),
    command=_command,
).run
