"""The examples of ``docs/extending.md`` do what the page says, in the files that it names."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "extending.md"
USES = Path(__file__).parent
BLOCK = re.compile(r"^```(python|diff)\n# (\S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def change(text: str, diff: str) -> str:
    """Return a text with a diff block applied, whose old lines must be there once."""
    lines = diff.splitlines()
    old = "\n".join(line[1:] for line in lines if line[0] in " -")
    new = "\n".join(line[1:] for line in lines if line[0] in " +")
    assert text.count(old + "\n") == 1, old
    return text.replace(old + "\n", new + "\n")


def _unfinished(folder: str, names: list[str]) -> list[str]:
    """Return what must not be copied: files that another process writes. What is compiled serves the copy, too."""
    compiled = Path(folder).name == "__pycache__"
    return [name for name in names if compiled and not name.endswith((".pyc", ".nbi", ".nbc"))]


@pytest.fixture(scope="module")
def extended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the packages with every example of the page in it."""
    copy = tmp_path_factory.mktemp("extended")
    for package in ("api", "estimation", "fleet_db", "ingest"):
        shutil.copytree(ROOT / package, copy / package, ignore=_unfinished)
    for language, name, body in BLOCK.findall(PAGE.read_text(encoding="utf-8")):
        file = copy / name
        if language == "python":
            assert not file.exists()
            file.write_text(body, encoding="utf-8")
        else:
            file.write_text(change(file.read_text(encoding="utf-8"), body), encoding="utf-8")
    return copy


@pytest.mark.slow
@pytest.mark.parametrize(
    "example",
    [
        "alert_rule",
        "stage",
        "window_table",
        "window_number",
        "refusal",
        "number",
        "estimator",
        "log_format",
        "profile_format",
    ],
)
def test_the_example_works(extended: Path, tmp_path: Path, example: str) -> None:
    # the packages of the copy go before those beside the benches, which the tests' own helpers use
    beside = [ROOT / "tests" / name for name in ("estimation", "fleet_db", "api")]
    path = os.pathsep.join(map(str, (extended, *beside, ROOT)))
    command = [sys.executable, str(USES / f"use_{example}.py"), str(tmp_path)]
    done = subprocess.run(
        command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith(str(extended))


FILES = {
    "An alert rule": 3,
    "A stage": 3,
    "A REST resource": 3,
    "A number of every window": 8,
    "A reason to refuse a window": 2,
    "One more number of a geometry": 3,
    "An estimator": 2,
    "A log format": 2,
    "A profile format": 2,
}


def test_an_example_touches_few_files() -> None:
    _, *sections = re.split(r"^## (.*)\n", PAGE.read_text(encoding="utf-8"), flags=re.MULTILINE)
    bodies = dict(zip(sections[::2], sections[1::2], strict=True))
    changed = {name: {file for _, file, _ in BLOCK.findall(body)} for name, body in bodies.items()}
    assert {name: len(files) for name, files in changed.items() if files} == FILES
