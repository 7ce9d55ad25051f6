"""One row of the accuracy table, small, from simulation to what is stored."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bench.fleet_case import score
from bench.report import write_page
from bench.section import row_scenario, tables
from ingest.simulator.drawn_fleet import with_seed


def test_a_small_row_runs_through_the_product(tmp_path: Path) -> None:
    whole = row_scenario("known", 1, drawn=False)
    assert whole.drawn is not None
    assert whole.section.recipe is not None
    short = replace(whole.section, recipe=replace(whole.section.recipe, length=2000.0))
    drawn = replace(whole.drawn, given_vehicles=1, wheelsets=2)
    scenario = with_seed(replace(whole, section=short, drawn=drawn, sessions=replace(whole.sessions, campaigns=2)), 1)
    found = score(scenario, tmp_path / "recordings", tmp_path / "data")
    said = [found[name] for name in ("row", "pair", "status", "alignment")]
    assert said == ["known", "S1002/60E1", "recorded", None]
    assert [item["serial"] for item in found["wheelsets"]] == ["W00", "W01"]
    assert [verdict["published"] for verdict in found["verdicts"]] == [True, True]
    assert found["windows"]["estimated"] >= 4
    assert len(found["cpu_s"]) == 3
    for item in found["wheelsets"]:
        assert item["error"] < 0.03
        assert item["conicity"]["published"] >= 4
        assert item["conicity"]["covered"] >= item["conicity"]["published"] - 2
    page = write_page("accuracy", "Accuracy", "python -m bench section", tables([found]), tmp_path).read_text()
    assert "| known |" in page
    assert "python -m bench section" in page
