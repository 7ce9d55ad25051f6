"""The page of alerts at the limit: its figures are no worse than those reached, over enough wheelsets."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "results" / "limits.md"
ROW = re.compile(r"^\| (?P<what>.+?) \| (?P<measured>.+?) \| (?P<reach>.+?) \| (?P<met>yes|NO) \|$", re.MULTILINE)

REACHED = 98.0
"""Of the wheelsets beyond their limit, %, on seeds that nothing was chosen on: not to become less."""


def share(text: str) -> float:
    """Return the first percentage of a cell."""
    found = re.search(r"([\d.]+)\s?%", text)
    assert found is not None
    return float(found.group(1))


def test_what_is_due_is_raised_and_what_is_below_is_not() -> None:
    rows = [row for row in ROW.finditer(PAGE.read_text()) if row["reach"] not in {"for information", "---", "reach"}]
    raised, over, below, quiet = rows
    wheelsets = re.search(r"(\d+) wheelsets", raised["what"])
    assert wheelsets is not None
    assert int(wheelsets.group(1)) >= 300
    assert share(raised["reach"]) == 98.0
    assert share(raised["measured"]) >= REACHED
    assert share(over["measured"]) >= share(over["reach"]) == 60.0
    for row in (below, quiet):
        assert share(row["measured"]) <= share(row["reach"]) == 1.0
    assert all(row["met"] == "yes" for row in (over, below, quiet))
