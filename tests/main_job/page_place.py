"""A folder as the pages have it, in which their commands run as they are written."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

from in_process_command import Done, Run
from tiny_fleet import DEAD, WORN

from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage
from ingest.simulator.fleet import FleetReport


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
