"""Figures of low adhesion that are decided: stretches found, and alarms without one, over enough kilometres."""

from __future__ import annotations

import re
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "results" / "adhesion.md"
FEWEST_STRETCHES, FEWEST_KM = 60, 600.0


def row(begin: str) -> list[str]:
    (line,) = (one for one in PAGE.read_text(encoding="utf-8").splitlines() if one.startswith(f"| {begin}"))
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_stretches_are_found() -> None:
    found = re.match(r"([\d.]+) % of (\d+);", row("stretches of friction < 0.15")[1])
    assert found is not None
    assert float(found.group(1)) >= 95.0
    assert int(found.group(2)) >= FEWEST_STRETCHES


def test_alarms_on_good_rails_are_rare() -> None:
    found = re.match(r"(\d+) in (\d+) vehicle-km", row("alarms without friction < 0.16")[1])
    assert found is not None
    alarms, km = int(found.group(1)), float(found.group(2))
    assert km >= FEWEST_KM
    assert alarms < 0.5e-3 * km
