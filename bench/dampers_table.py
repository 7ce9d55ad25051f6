"""Tables of the dampers bench."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.dampers_case import BAD, OTHER_CLASS, ROWS, SHARES, errors_of
from bench.report import COLUMNS, BenchRow
from bench.results_page import markdown_table

TITLE = "Lateral dampers"
HEADER = ("vehicle", "share", "gears", "published", "rms error", "95 % of errors", "intervals cover", "found weak")
Score = Mapping[str, Any]


def bench_rows(found: Sequence[Score]) -> Iterator[BenchRow]:
    """Yield what was to be reached."""
    good = [one for one in found if not one["bad"]]
    published = [one for one in good if one["value"] is not None]
    covered = [one["low"] <= one["share"] <= one["high"] for one in published]
    weak, whole = ([one for one in good if test(one["share"])] for test in (_is_weak, _is_whole))
    hits, false = sum(one["weak"] is True for one in weak), sum(one["weak"] is True for one in whole)
    yield BenchRow("dampers with a share of 0.2 found weak", f"{hits} of {len(weak)}", "95 %", hits >= 0.95 * len(weak))
    yield BenchRow("whole dampers found weak", f"{false} of {len(whole)}", "0", not false)
    part = np.mean(covered)
    yield BenchRow("intervals cover", f"{sum(covered)} of {len(covered)}: {part:.1%}", "at least 92 %", part >= 0.92)
    refused = sum(one["value"] is None for one in found if one["bad"])
    bad = sum(bool(one["bad"]) for one in found)
    yield BenchRow("bad input without a number", f"{refused} of {bad}", "all", refused == bad)
    cpu, running = (sum(one[name] for one in good) for name in ("cpu_s", "running_s"))
    factor = running / max(cpu, 1e-9)
    yield BenchRow("real-time factor per wheelset and core", f"{factor:,.0f}", "1,000", factor >= 1000.0)


def _is_weak(share: float) -> bool:
    return share == SHARES[-1]


def _is_whole(share: float) -> bool:
    return share == SHARES[0]


def table(found: Sequence[Score]) -> list[tuple[str, ...]]:
    """Return the rows of good input, by vehicle and share."""
    rows = []
    for row in ROWS:
        for share in SHARES:
            own = [one for one in found if (one["row"], one["share"], one["bad"]) == (row, share, "")]
            if own:
                rows.append((row, f"{share:g}", *_cells(own)))
    return rows


def _cells(own: Sequence[Score]) -> tuple[str, ...]:
    published = [one for one in own if one["value"] is not None]
    weak = f"{sum(one['weak'] is True for one in own)}"
    if not published:
        return str(len(own)), "0", "", "", "", weak
    errors = errors_of(published)
    covered = sum(one["low"] <= one["share"] <= one["high"] for one in published)
    rms, largest = float(np.sqrt(np.mean(errors**2))), float(np.quantile(np.abs(errors), 0.95))
    return str(len(own)), str(len(published)), f"{rms:.3f}", f"{largest:.3f}", f"{covered} of {len(published)}", weak


def bad_table(found: Sequence[Score]) -> list[tuple[str, str, str, str]]:
    """Return the rows of bad input."""
    rows = []
    for bad in (*BAD, OTHER_CLASS):
        own = [one for one in found if one["bad"] == bad]
        codes = Counter(one["reason"] for one in own if one["reason"])
        published = sum(one["value"] is not None for one in own)
        rows.append((bad, str(len(own)), str(published), ", ".join(f"`{code}` {n}" for code, n in codes.most_common())))
    return rows


def page_body(found: Sequence[Score]) -> list[str]:
    """Return the page of results."""
    seeds = sorted({one["seed"] for one in found})
    refused = Counter(one["reason"] for one in found if not one["bad"] and one["reason"])
    reasons = ", ".join(f"`{code}` {count}" for code, count in refused.most_common()) or "none"
    head = (
        f"Seeds {', '.join(map(str, seeds))}: each vehicle has masses, springs and other dampers drawn by the standard"
        " deviations of its class, and 8 windows of 60 s. The share is that of the damping on file which is left."
    )
    return [
        head,
        markdown_table(COLUMNS, [row.cells for row in bench_rows(found)], (1, 2)),
        markdown_table(HEADER, table(found), range(1, 8)),
        f"Refused with good input: {reasons}.",
        "Bad input, of whole dampers:",
        markdown_table(("input", "gears", "published", "refused"), bad_table(found), (1, 2)),
    ]
