"""The page of the chaos run: a part that runs again replaces its own section only."""

from __future__ import annotations

from pathlib import Path

from bench.chaos.run import write_section


def test_a_part_that_runs_again_replaces_its_section_and_leaves_the_others(tmp_path: Path) -> None:
    for name, measured in (("kills", "1 lost"), ("clock", "0 lost"), ("kills", "0 lost, again")):
        write_section(name, "what happens", f"chaos {name}", 1.5, [("rows", measured, "0", "yes")], tmp_path)
    page = (tmp_path / "chaos.md").read_text()
    assert page.count("## ") == 2
    assert page.index("## clock") < page.index("## kills")
    assert "| rows | 0 lost |" in page
    assert "| rows | 0 lost, again |" in page
    assert "1 lost" not in page
