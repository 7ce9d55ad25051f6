"""Wheel flats: ``python -m bench flats [--wheelsets 320] [--first-seed 200] [--write-docs]``.

Wheelsets of drawn class, wear, speed and vibration run for a minute each on drawn track. Every one is measured without
a flat, with a flat of drawn size, and with two of what resembles flats: joints, switches, polygons, sleepers, flange
contact. The window is judged as ingest judges it (``flats_case``). Constants were chosen on seeds 1 and 113.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from contextlib import suppress

from rich.console import Console

from bench.flats_case import Judged, judged_windows
from bench.flats_table import HEADER, TITLE, bench_rows, page_body, table
from ingest.simulator.axle_motion import DerailmentError


def main(arguments: Sequence[str]) -> int:
    """Run what was asked for; return 1 when a row falls short."""
    options = _options(arguments)
    console, found, seed = Console(width=None if Console().is_terminal else 200), list[Judged](), options.first_seed
    while len({one.window for one in found}) < options.wheelsets:
        with suppress(DerailmentError):  # a drawn wheelset that climbs its rail at the drawn speed is no case
            found += list(judged_windows(seed))
        seed += 1
    rows = list(bench_rows(found))
    for cells in (HEADER, *table(found), *(row.cells for row in rows)):
        console.print("  ".join(cells), highlight=False, soft_wrap=True)
    if options.write_docs:
        from bench.results_page import write_page  # noqa: PLC0415 - only where it is asked for

        command = f"python -m bench flats --wheelsets {options.wheelsets} --write-docs"
        page = write_page("flats", TITLE, command, page_body(found))
        console.print(f"wrote {page}", highlight=False)
    return 0 if all(row.met for row in rows) else 1


def _options(arguments: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m bench flats", description=__doc__)
    parser.add_argument("--wheelsets", type=int, default=320, help="windows of wheelsets (default: 320)")
    parser.add_argument("--first-seed", type=int, default=200, help="seeds go up from here (default: 200)")
    parser.add_argument("--write-docs", action="store_true", help="write docs/results/flats.md")
    return parser.parse_args(arguments)
