"""The commands of docs/corrections.md run as they are written, and do what the page says."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
from in_process_command import Done, Run
from tiny_fleet import DEAD, WORN

from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from ingest.simulator.fleet import FleetReport

PAGE = Path(__file__).parents[2] / "docs" / "corrections.md"


class Place:
    """A folder with a registry, recordings and a data folder, as the page has them."""

    def __init__(self, folder: Path, report: FleetReport, run: Run) -> None:
        self.folder, self._run, self.data = folder, run, folder / "data"
        self.data.mkdir()
        shutil.copytree(report.registry.parent, folder, dirs_exist_ok=True)
        recordings = folder / "recordings"
        recordings.mkdir()
        for item in report.recordings[:1]:  # one campaign
            shutil.copy(item.path, recordings / item.path.name)
        self.url = f"sqlite:///{self.data / 'treadwatch.sqlite'}"
        upgrade(self.url)
        entries = json.loads((folder / report.registry.name).read_text(encoding="utf-8"))
        (folder / "registry.json").write_text(json.dumps(entries), encoding="utf-8")
        self.names = {"WS-1011": WORN, "N-101": "T-1", "2024-01-08T05:30:00Z": entries["mountings"][0]["from"]}

    def __call__(self, line: str) -> Done:
        """Run a line of the page with the names of this fleet."""
        for theirs, ours in self.names.items():
            line = line.replace(theirs, ours)
        words = re.findall(r'"[^"]*"|\S+', line)
        assert words.pop(0) == "treadwatch"
        done = self._run(*(word.strip('"') for word in words), data_dir=str(self.data), window_length_s="30")
        assert done.returncode == 0, (line, done.stderr, done.stdout)
        return done

    def windows(self) -> dict[str, list[tuple[str, str, str | None]]]:
        storage = SqlStorage(database_engine(self.url), self.data)
        with storage.read() as unit:
            found = {
                serial: [(w.content_digest, w.state.value, w.track_section) for w in unit.windows.list(serial)]
                for serial in (WORN, DEAD)
            }
        storage.close()
        return found


def lines() -> list[str]:
    return re.findall(r"^    (treadwatch .*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)


@pytest.fixture
def place(tmp_path: Path, report: FleetReport, treadwatch: Run) -> Place:
    return Place(tmp_path, report, treadwatch)


def test_the_page_is_run_line_by_line(place: Place) -> None:
    place("treadwatch ingest --registry registry.json recordings/")
    place("treadwatch estimate")
    right = place.windows()
    assert {state for found in right.values() for _, state, _ in found} == {"estimated"}
    for line in lines():
        if line.startswith("treadwatch ingest"):
            shutil.rmtree(place.data / "windows")
        done = place(line)
        if " void " in line:
            place("treadwatch estimate")
            assert place.windows() == right | {WORN: []}
        elif " restore " in line:
            place("treadwatch estimate")
            assert place.windows() == right
        elif " history " in line:
            assert re.search(r"voided mounting.*was WS-1012.*\n.*restored mounting.*it was right", done.stdout)
        elif line.startswith("treadwatch ingest"):
            assert len(list((place.data / "windows").rglob("*.window"))) == sum(map(len, right.values()))
        elif line.startswith("treadwatch reassemble"):
            assert "new 0, changed 0, removed 0, healed 0" in done.stdout
    assert place.windows() == right


def test_lost_windows_that_a_corrected_track_file_needs_are_made_again(place: Place) -> None:
    place("treadwatch ingest --registry registry.json recordings/")
    place("treadwatch estimate")
    right = place.windows()
    for file in (place.data / "windows").rglob("*.window"):
        file.unlink()
    entries = json.loads((place.folder / "registry.json").read_text(encoding="utf-8"))
    track = place.folder / entries["track_sections"][0]["alignment"]["file"]
    head, first, *rest = track.read_text(encoding="utf-8").splitlines()
    s, alignment, *others = first.split(",")
    corrected = [head, ",".join([s, f"{float(alignment) + 0.01:.4f}", *others]), *rest]
    track.write_text("\n".join(corrected) + "\n", encoding="utf-8")
    place("treadwatch registry load registry.json")
    place("treadwatch estimate")  # finds that the files are lost
    place("treadwatch estimate")
    assert place.windows() == right


def test_two_wheelsets_that_were_swapped_in_the_file_are_put_right_by_the_file(place: Place) -> None:
    registry = place.folder / "registry.json"
    right = json.loads(registry.read_text(encoding="utf-8"))
    other = {WORN: DEAD, DEAD: WORN}
    wrong = right | {"mountings": [one | {"wheelset": other[one["wheelset"]]} for one in right["mountings"]]}
    registry.write_text(json.dumps(wrong), encoding="utf-8")
    place("treadwatch ingest --registry registry.json recordings/")
    place("treadwatch estimate")
    mistaken = place.windows()
    registry.write_text(json.dumps(right), encoding="utf-8")
    place("treadwatch registry load registry.json")
    place("treadwatch estimate")
    corrected = place.windows()
    place("treadwatch reassemble --vehicle N-101")
    assert place.windows() == corrected
    assert {state for found in corrected.values() for _, state, _ in found} == {"estimated"}
    assert not {one[0] for found in corrected.values() for one in found} & {
        one[0] for found in mistaken.values() for one in found
    }
