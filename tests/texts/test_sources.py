"""Sources as text: functions that fit a screen, mutants in place."""

from __future__ import annotations

import tomllib
from pathlib import Path

from bench.house import complex_functions, figures, static_counts

ROOT = Path(__file__).parents[2]


def test_what_is_reached_stays_reached() -> None:
    assert list(complex_functions(ROOT)) == []
    counts, most = {count.what: int(count.now) for count in static_counts(ROOT)}, figures(ROOT)
    assert counts["modules loose at the top of estimation/"] <= 6
    assert counts["product lines"] <= most["product lines"]
    assert counts["modules"] <= most["modules"]


def test_every_mutant_has_its_place_and_its_tests() -> None:
    listed = tomllib.loads((ROOT / "bench" / "mutants.toml").read_text(encoding="utf-8"))["threshold"]
    assert len(listed) > 200
    for entry in listed:
        assert (ROOT / entry["module"]).read_text(encoding="utf-8").count(entry["find"]) == 1, entry["name"]
        assert all((ROOT / test).exists() for test in entry["tests"]), entry["name"]
