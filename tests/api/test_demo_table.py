"""The demo's table on a narrow terminal."""

from __future__ import annotations

import io

from rich.console import Console

from api.demo.findings import WheelsetLine, tables

LINES = [
    WheelsetLine(
        serial="WS-1034",
        mileage_km=298_765.4,
        true=0.412,
        value=0.4051,
        low=0.385,
        high=0.4255,
        slope_per_1000_km="+0.00102 [+0.00098, +0.00106]",
        distance="112,000 [88,400, beyond]",
        alerts="conicity_limit (critical), limit_forecast (warning)",
    ),
    WheelsetLine("WS-1032", None, None, None, None, None, "unknown", "unknown", "none"),
]


def printed(width: int) -> list[str]:
    console = Console(file=io.StringIO(), width=width)
    for table in tables(LINES, console):
        console.print(table)
    text = console.file.getvalue()  # type: ignore[attr-defined] # a StringIO
    return [line.rstrip() for line in text.splitlines() if line.strip()]


def test_80_columns_hold_every_number_on_one_line() -> None:
    lines = printed(80)
    assert max(map(len, lines)) <= 80
    (estimate,) = [line for line in lines if "298,765" in line]
    assert "0.405 [0.385, 0.425]" in estimate or "0.405 [0.385, 0.426]" in estimate
    assert sum("WS-1034" in line for line in lines) == 3
    assert any("112,000 [88,400, beyond]" in line for line in lines)
    assert any("[p10, p90]" in line for line in lines)
    assert any("conicity_limit (critical), limit_forecast (warning)" in line for line in lines)


def test_a_wide_terminal_has_one_table() -> None:
    assert sum("WS-1034" in line for line in printed(200)) == 1
