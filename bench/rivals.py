"""Rival estimators on the same windows: ``python -m bench rivals [--seeds 0-19] [--families smooth,P8/113A] ...``.

Every fleet is recorded, received and its windows made by the scheduled jobs; then every estimator of the catalogue gets
the same motion (``rivals_case``). Results are written as JSON after every fleet, so that nothing is lost on the way.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console

from api.comparison.study import TrackInformation
from bench.results_page import write_page
from bench.rivals_case import scores
from bench.rivals_fleets import FAMILIES, fleet
from bench.rivals_table import TITLE, bench_rows, page_body, summary_lines
from bench.world import seed_range
from estimation.estimators.catalogue import estimators


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console = Console(width=None if Console().is_terminal else 200)
    found: list[dict[str, Any]] = json.loads(options.out.read_text()) if options.resume and options.out.exists() else []
    if not options.print_only:
        _run(options, found, console)
    for line in summary_lines(found):
        console.print(line, highlight=False, soft_wrap=True)
    rows = list(bench_rows(found))
    for row in rows:
        shown = f"{row.what}: {row.measured} (reach {row.reach}): {'yes' if row.met else 'NO'}"
        console.print(shown, highlight=False, soft_wrap=True)
    if options.write_docs:
        page = write_page("rivals", TITLE, "python -m bench rivals --write-docs", page_body(found))
        console.print(f"wrote {page}", highlight=False)
    return 0 if all(row.met for row in rows) else 1


def _run(options: argparse.Namespace, found: list[dict[str, Any]], console: Console) -> None:
    have = {(one["family"], one["seed"], one["track"]) for one in found}
    for seed in options.seeds:
        for family in options.families:
            tracks = [track for track in options.tracks if (family, seed, track.value) not in have]
            if not tracks:
                continue
            with tempfile.TemporaryDirectory(prefix="treadwatch-rivals-") as folder:
                cache = options.keep or Path(folder) / "recordings"
                scenario = fleet(family, seed, options.vehicles, cache / "wheels")
                case = scores(
                    scenario, family, tracks, cache, Path(folder) / "data", options.wheelsets, options.estimators
                )
                found.extend(one.as_json() for one in case)
            options.out.write_text(json.dumps(found), encoding="utf-8")
            console.print(f"{family} seed {seed}: done", highlight=False)


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench rivals", description=__doc__)
    parser.add_argument("--seeds", type=seed_range, default=list(range(20)), help="as in 0-19 or 3 (default: 0-19)")
    parser.add_argument("--families", type=_of(FAMILIES), default=list(FAMILIES), help=", ".join(FAMILIES))
    names = [track.value for track in TrackInformation]
    parser.add_argument("--tracks", type=_tracks, default=list(TrackInformation), help=", ".join(names))
    every = [item.name for item in estimators()]
    parser.add_argument("--estimators", type=_of(every), default=every, help="names; the shipped one always runs")
    parser.add_argument("--vehicles", type=int, default=4, help="of four wheelsets (4)")
    parser.add_argument("--wheelsets", type=int, default=16, help="that are scored, spread over the fleet (16)")
    parser.add_argument("--keep", type=Path, default=None, help="folder that keeps recordings")
    parser.add_argument("--out", type=Path, default=Path("rivals.json"))
    parser.add_argument("--resume", action="store_true", help="go on with the results in --out")
    parser.add_argument("--print-only", action="store_true", help="print what --out holds, with --resume")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/rivals.md")
    return parser.parse_args(arguments)


def _of(known: Sequence[str]) -> Any:  # noqa: ANN401 - a type of argparse
    def names(text: str) -> list[str]:
        chosen = text.split(",")
        if not set(chosen) <= set(known):
            raise argparse.ArgumentTypeError(f"{text!r}: there are {', '.join(known)}")
        return chosen

    return names


def _tracks(text: str) -> list[TrackInformation]:
    return [TrackInformation(name) for name in _of([track.value for track in TrackInformation])(text)]
