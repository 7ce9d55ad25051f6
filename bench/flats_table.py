"""Tables of the flat bench: detection against size, vibration and speed; what is taken for a flat that is none."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bench.flats_case import SIZES, VIBRATIONS, Judged
from bench.report import COLUMNS, BenchRow
from bench.results_page import markdown_table

TITLE = "Wheel flats"
HEADER = (
    "blows at 20 m/s",
    *(f"vibration {one:g} m/s2" for one in VIBRATIONS),
    "below 15 m/s",
    "faster",
    "side known, right",
)
FALSE_ALARMS = 0.003  # share of the windows without a flat
POWER = 0.99  # from 40 m/s2 on, of vibration up to 5 m/s2
POWER_OF_ROUGH = 0.95  # from 60 m/s2 on, of 10 m/s2
SLOW = 15.0  # m/s
EXPLANATION = (
    "Share of the windows of a minute in which a flat is found (blows once a turn for half of the time, at a turn"
    " within 10 % of the wheel's), by the size of its blows before the filter of the node, at 20 m/s; they grow with"
    " the speed."
)


def table(found: Sequence[Judged]) -> list[tuple[str, ...]]:
    """Return a line for each size of flat.

    Args:
        found: Of all windows.
    """
    return [_line(size, [one for one in found if one.what == "flat" and one.size == size]) for size in SIZES]


def _line(size: float, flats: Sequence[Judged]) -> tuple[str, ...]:
    told = [one.side_right for one in flats if one.side_right is not None]
    return (
        f"{size:g} m/s2",
        *(_share([one for one in flats if one.vibration == vibration]) for vibration in VIBRATIONS),
        _share([one for one in flats if one.speed < SLOW]),
        _share([one for one in flats if one.speed >= SLOW]),
        f"{len(told)} of {sum(one.found for one in flats)}, {sum(told)}",
    )


def bench_rows(found: Sequence[Judged]) -> Iterator[BenchRow]:
    """Yield what has to be reached.

    Args:
        found: Of all windows.
    """
    smooth = [one for one in found if one.what == "flat" and one.size >= SIZES[2] and one.vibration < VIBRATIONS[3]]
    rough = [one for one in found if one.what == "flat" and one.size >= SIZES[3] and one.vibration == VIBRATIONS[3]]
    yield _power("flats from 40 m/s2 on, vibration up to 5 m/s2", smooth, POWER)
    yield _power("flats from 60 m/s2 on, vibration of 10 m/s2", rough, POWER_OF_ROUGH)
    others = [one for one in found if one.what != "flat"]
    for what in dict.fromkeys(one.what for one in others):
        yield _false(what, [one for one in others if one.what == what])
    yield _false("all without a flat", others)
    told = [one.side_right for one in found if one.side_right is not None]
    right = sum(told) / len(told) if told else 0.0
    yield BenchRow("side, where it is known", f"right in {right:.1%} of {len(told)}", "99.0%", right >= POWER)


def _power(what: str, flats: Sequence[Judged], reach: float) -> BenchRow:
    share = sum(one.found for one in flats) / max(len(flats), 1)
    return BenchRow(what, f"{share:.1%} of {len(flats)} found", f">= {reach:.0%}", share >= reach)


def _false(what: str, windows: Sequence[Judged]) -> BenchRow:
    false = sum(one.found for one in windows)
    reach = FALSE_ALARMS * len(windows)
    clipped = sum(one.clipped > 0.0 for one in windows)
    measured = f"{false} of {len(windows)} taken for a flat; {clipped} with clipped samples"
    return BenchRow(f"{what}: false alarms", measured, f"<= {FALSE_ALARMS:.1%}", false <= reach)


def _share(windows: Sequence[Judged]) -> str:
    return f"{sum(one.found for one in windows)} of {len(windows)}"


def page_body(found: Sequence[Judged]) -> list[str]:
    """Return the tables for a page of results.

    Args:
        found: Of all windows.
    """
    rows = [row.cells for row in bench_rows(found)]
    return [EXPLANATION, markdown_table(HEADER, table(found), range(1, 7)), markdown_table(COLUMNS, rows)]
