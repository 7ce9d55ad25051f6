"""Tables of the world bench: rows against what they have to reach, and intervals against diversity."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from bench.report import ResultTable, write_page
from bench.world import tables


def case(row: str, diversity: float, widths: list[float], *, covered: int, error: float = 0.01) -> dict[str, Any]:
    published = [(error, width, place < covered) for place, width in enumerate(widths)]
    wheelsets = [{"serial": "W", "error": error, "compared": published, "withheld": []}] if widths else []
    survey = "survey_confirmed" if row.startswith("known") else ""
    return {"row": row, "survey": survey, "wheelsets": wheelsets, "verdicts": [], "diversity": diversity}


def cells(table: ResultTable) -> list[dict[str, str]]:
    return [dict(zip(table.header, row, strict=True)) for row in table.rows]


def test_widths_are_printed_against_the_diversity_of_fleets_on_unknown_track() -> None:
    cases = [
        case("unknown_alike_02", 0.05, [], covered=0),
        case("unknown_alike_02", 0.15, [0.2, 0.3, 0.4], covered=3, error=0.02),
        case("unknown_alike_05", 0.2, [0.6], covered=0, error=0.04),
        case("unknown_alike_08", 0.0, [], covered=0),
        case("unknown_long_gauge", 1.2, [0.01], covered=1),
        case("known_alike", 0.15, [9.0], covered=0),
    ]
    rows = cells(tables(cases)[1])
    assert [row["diversity"] for row in rows] == ["0 to 0.1", "0.1 to 0.2", "above 0.8", "none"]
    assert [row["fleets"] for row in rows] == ["1", "2", "1", "1"]
    assert [row["nothing published"] for row in rows] == ["1", "0", "0", "1"]
    assert rows[1]["covers"].startswith("0.750 [0.")
    assert rows[1]["half width: median"] == "0.3500"
    assert rows[1]["error: median"] == "0.0300"


def test_a_row_counts_the_fleets_of_which_nothing_was_published(tmp_path: Path) -> None:
    cases = [
        case("unknown_alike_02", 0.1, [], covered=0),
        case("unknown_alike_02", 0.1, [0.2], covered=1),
        case("known_alike", 0.2, [0.02] * 20, covered=19, error=0.016),
    ]
    known, unknown = cells(tables(cases)[0])
    assert (unknown["seeds"], unknown["nothing published"], unknown["met"]) == ("2", "1", "not decided")
    assert (known["survey right"], known["covers"][:5], known["met"]) == ("1 of 1", "0.950", "NO")
    page = write_page("world", "World", "bench", tables(cases), tmp_path).read_text()
    assert "| unknown_alike_02 | 2 | 1 |" in page
    assert "| 0 to 0.1 | 2 | 1 | 1.000 [" in page
    assert len(tables(cases[2:])) == 1  # nothing of unknown track
