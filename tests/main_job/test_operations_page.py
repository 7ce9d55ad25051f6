"""The commands of docs/operations.md run as they are written and do what the page says."""

from __future__ import annotations

import re
from pathlib import Path

from page_place import Place

PAGE = Path(__file__).parents[2] / "docs" / "operations.md"
IN_ORDER = {  # as the page has it: as it is run here
    "db upgrade": "db upgrade",
    "ingest --registry registry.json recordings/": "ingest --registry registry.json recordings/",
    "ingest FILES": "ingest recordings/",
    "estimate": "estimate",
    "recordings": "recordings list --vehicle T-1",
    "quarantine list": "quarantine list",
    "reassemble --vehicle V": "reassemble --vehicle T-1",
    "db check --deep": "db check --deep",
    "db purge": "db purge",
    "backup FOLDER": "backup kept",
    "restore FOLDER": "restore kept",
}
ELSEWHERE = {
    "ingest --interface ... --channel ... --vehicle ...",  # tests/ingest/test_live_process.py
    "estimate --job NAME",  # below, for each job
    "schedule",  # these as services of docker-compose.yml: tests/compose
    "schedule &",
    "schedule --wait",
    "serve",
    "worker",  # test_dask_workers.py
}


def commands() -> set[str]:
    found = re.findall(r"^ {4}treadwatch (.+)$|`treadwatch ([^`]+)`", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    return {block or inline for block, inline in found}


def test_every_command_of_the_page_runs(place: Place) -> None:
    assert commands() == {*IN_ORDER, *ELSEWHERE}
    right = {}
    for written, command in IN_ORDER.items():
        if written.startswith("reassemble"):
            for file in (place.data / "windows").rglob("*.window"):
                file.unlink()
        elif written.startswith("restore"):
            place.data.rename(place.folder / "lost")
        done = place(f"treadwatch {command}")
        if written == "estimate":
            right = place.windows()
            assert {state for found in right.values() for _, state, _ in found} == {"estimated"}
        elif written == "recordings":
            assert "decoded" in done.stdout
        elif written.startswith("reassemble"):
            assert len(list((place.data / "windows").rglob("*.window"))) == sum(map(len, right.values()))
    assert place.windows() == right
    jobs = re.findall(r"^\| `(\w+)` \| \d+ [sh] \|", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert jobs.pop() == "purge"  # which has a command of its own
    assert len(jobs) == 9
    for name in jobs:
        place(f"treadwatch estimate --job {name}")
    assert place.windows() == right
