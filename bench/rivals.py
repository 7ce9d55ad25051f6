"""Rival estimators on the same windows: ``python -m bench rivals [--seeds 0-19] [--families smooth,P8/113A] ...``.

Every fleet is recorded, received and its windows made by the scheduled jobs; then every estimator of the catalogue gets
the same motion (``rivals_case``).
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Collection, Iterator, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from api.comparison.study import TrackInformation
from bench.report import BenchRow, Part, ResultTable, row_table
from bench.rivals_case import FAMILIES, JUMPS, SMOOTH, STEP, fleet, scores
from bench.study import Case, Key, Study, one_of
from estimation.estimators.catalogue import estimators

HEADER = (
    "wheels", "track", "estimator", "wheelsets with a conicity", "error, median", "error, 95th percentile",
    "published intervals cover", "own covariance covers", "real-time factor", "state, kB",
)  # fmt: skip
NEAR = 3  # amplitudes 1.0, 1.25 and 1.5 mm come first
REACH_NEAR, REACH_SPEED, FOLLOWS = 0.01, 1000.0, 0.01
DEFAULT, OF_TODAY = "bins", "hidden"
NEAR_TEXT = (
    "Next to contact jumps (P8/113A, 1.0 to 1.5 mm). The simulator's contact tables have points every {:g} mm here, so "
    "that jumps are where the profiles have them. 'As run' is against that table; its conicity is itself off by {:.4f} "
    "(95th percentile) from that of the profiles."
)


def _chosen(found: Sequence[Case], **wanted: str) -> list[Case]:
    return [one for one in found if all(one[key] == value for key, value in wanted.items())]


def _errors(found: Sequence[Case], key: str = "errors", near: bool = False) -> np.ndarray[Any, Any]:  # noqa: FBT001, FBT002 - of this file
    every = [error for one in found for error in (one[key][:NEAR] if near else one[key])]
    return np.abs(np.array([error for error in every if error is not None], dtype=np.float64))


def _share(found: Sequence[Case], key: str) -> str:
    every = [inside for one in found for inside in one[key]]
    return f"{100 * sum(every) / len(every):.0f} % of {len(every)}" if every else ""


def table_rows(found: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return the rows of the table: fleet, track and estimator in the order in which they were run."""
    keys = list(dict.fromkeys((one["family"], one["track"], one["estimator"]) for one in found))
    rows = []
    for family, track, estimator in keys:
        of = _chosen(found, family=family, track=track, estimator=estimator)
        errors = _errors(of)
        given = sum(any(error is not None for error in one["errors"]) for one in of)
        codes = sorted({one["reason"] for one in of if one["reason"]})
        shown = f"{given} of {len(of)}" + (f" ({', '.join(codes)})" if codes else "")
        quantiles = [f"{np.quantile(errors, level):.4f}" if len(errors) else "" for level in (0.5, 0.95)]
        speed = sum(one["running_s"] for one in of) / max(sum(one["cpu_s"] for one in of), 1e-9)
        size = f"{np.median([one['state_bytes'] for one in of]) / 1e3:.0f}"
        covers = (_share(of, "covered"), _share(of, "own_covered"))
        rows.append((family, track, estimator, shown, *quantiles, *covers, f"{speed:.0f}", size))
    return rows


def near_rows(found: Sequence[Case]) -> list[tuple[str, ...]]:
    """Return what comes out next to contact jumps, 1.0 to 1.5 mm: against profiles and against what was run on."""
    rows = []
    jumps = _chosen(found, family=JUMPS)
    for track, estimator in dict.fromkeys((one["track"], one["estimator"]) for one in jumps):
        of = _chosen(jumps, track=track, estimator=estimator)
        cells = [track, estimator]
        for key in ("errors", "errors_as_run"):
            errors = _errors(of, key, near=True)
            cells += [f"{np.quantile(errors, level):.4f}" if len(errors) else "" for level in (0.5, 0.95)]
        rows.append(tuple(cells))
    return rows


def floor(found: Sequence[Case]) -> float:
    """Return the 95th percentile, next to jumps, of what the simulator's table changes of the conicity."""
    jumps = _chosen(found, family=JUMPS, track="known", estimator=DEFAULT)
    apart = [
        abs(a - b)
        for one in jumps
        for a, b in zip(one["errors"][:NEAR], one["errors_as_run"][:NEAR], strict=True)
        if a is not None
    ]
    return float(np.quantile(apart, 0.95)) if apart else float("nan")


def bench_rows(found: Sequence[Case]) -> Iterator[BenchRow]:
    """Yield what was to be reached."""
    known = _chosen(found, family=JUMPS, track="known")
    for estimator in (DEFAULT, OF_TODAY):
        of = _chosen(known, estimator=estimator)
        for key, words in (("errors", "the profiles"), ("errors_as_run", "the table that was run on")):
            errors = _errors(of, key, near=True)
            if len(errors):
                p95 = float(np.quantile(errors, 0.95))
                what = f"{estimator}, next to contact jumps, known track, against {words}: 95th percentile"
                yield BenchRow(what, f"{p95:.4f}", f"{REACH_NEAR}", p95 <= REACH_NEAR)
    smooth = _chosen(found, family=SMOOTH, track="known")
    for estimator in ("extended_kalman", "cubic", OF_TODAY):
        errors = _errors(_chosen(smooth, estimator=estimator))
        if len(errors):
            median = float(np.median(errors))
            what = f"{estimator} on smooth wheels, known track: median error"
            yield BenchRow(what, f"{median:.4f}", f"{FOLLOWS}", median <= FOLLOWS)
    for estimator in ("extended_kalman", "particles", OF_TODAY):
        of = _chosen(found, estimator=estimator)
        if of:
            speed = sum(one["running_s"] for one in of) / max(sum(one["cpu_s"] for one in of), 1e-9)
            what = f"{estimator}: real-time factor per wheelset and core"
            yield BenchRow(what, f"{speed:.0f}", f"{REACH_SPEED:.0f}", speed >= REACH_SPEED)


def parts(found: Sequence[Case]) -> list[Part]:
    """Return the page of results."""
    seeds = sorted({(one["family"], one["seed"]) for one in found})
    listed = "; ".join(f"{name}: {', '.join(str(s) for f, s in seeds if f == name)}" for name in dict(seeds))
    near = ("track", "estimator", "profiles, median", "95th percentile", "as run, median", "95th percentile")
    return [
        f"Seeds: {listed}. Errors are of the equivalent conicity at 1.0 to 3.0 mm, against the profiles.",
        ResultTable(HEADER, table_rows(found), range(4, 10)),
        NEAR_TEXT.format(1e3 * STEP, floor(found)),
        ResultTable(near, near_rows(found), range(2, 6)),
        row_table(bench_rows(found)),
    ]


def _cases(options: argparse.Namespace, done: Collection[Key]) -> Iterator[Case]:
    for seed, family in product(options.seeds, options.families):
        tracks = [track for track in options.tracks if (family, seed, track) not in done]
        if not tracks:
            continue
        with tempfile.TemporaryDirectory(prefix="treadwatch-rivals-") as name:
            cache, folder = options.keep or Path(name) / "recordings", Path(name) / "data"
            scenario = fleet(family, seed, options.vehicles, cache / "wheels")
            known = [TrackInformation(track) for track in tracks]
            made = list(scores(scenario, family, known, cache, folder, options.wheelsets, options.estimators))
        for track in tracks:
            of_track = [asdict(one) for one in made if one.track == track]
            yield {"family": family, "seed": seed, "track": track, "scores": of_track}


def _options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--families", type=one_of(FAMILIES), default=list(FAMILIES), help=", ".join(FAMILIES))
    tracks = [str(track.value) for track in TrackInformation]
    parser.add_argument("--tracks", type=one_of(tracks), default=tracks, help=", ".join(tracks))
    every = [item.name for item in estimators()]
    parser.add_argument("--estimators", type=one_of(every), default=every, help="names; the shipped one always runs")
    parser.add_argument("--vehicles", type=int, default=4, help="of four wheelsets (4)")
    parser.add_argument("--wheelsets", type=int, default=16, help="that are scored, spread over the fleet (16)")
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings")


main = Study(
    name="rivals",
    title="Rival estimators",
    about=__doc__ or "",
    cases=_cases,
    parts=lambda cases: parts([one for case in cases for one in case["scores"]]),
    line=lambda case: f"{case['family']} seed {case['seed']}, track {case['track']}: done",
    seeds="0-19",
    key=("family", "seed", "track"),
    options=_options,
).run
