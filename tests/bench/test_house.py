"""The counts of ``python -m bench house``: each fault of a small tree is found."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from bench.house import entered_files
from bench.loose_constants import loose_constants

ROOT = Path(__file__).resolve().parents[2]
UNDOCUMENTED = '''
def solved(first, second, third):
    """Return nothing.

    Parameters
    ----------
    first, second
        Numbers.
    """
'''


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    """Return a tree that has one fault of every kind."""
    branches = "".join(f"    if x == {i}:\n        return {i}\n" for i in range(11))
    lines = "    x = 1\n" * 50
    files = {
        "api/__init__.py": "",
        "ingest/__init__.py": "",
        "fleet_db/__init__.py": "",
        "fleet_db/versions/__init__.py": "x = 0\n" * 500,
        "estimation/__init__.py": "",
        "estimation/loose.py": UNDOCUMENTED,
        "estimation/jobs/__init__.py": f"def long():\n{lines}\ndef branched(x):\n{branches}",
        "tests/test_long.py": "x = 0\n" * 401,
        "README.md": "Values are heard little.\n",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    return tmp_path


def test_each_fault_of_a_tree_is_printed_with_its_place(tree: Path) -> None:
    command = [sys.executable, "-m", "bench", "house", "--static", "--list", "--root", str(tree)]
    printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for place in (
        "loose.py",
        "estimation/jobs/__init__.py:1 long: 51 lines",
        "`branched` is too complex (12 > 10)",
        "tests/test_long.py: 401 lines",
        "heard: 1",
    ):
        assert place in printed
    assert "versions" not in printed


def test_values_infrastructure_and_the_alignment_job_are_no_part_of_the_path() -> None:
    traced = {
        "ingest": {"ingest/codec.py": ["decode"], "api/cli.py": ["main"], "estimation/values/windows.py": ["mean"]},
        "refresh_alignment": {"estimation/track/section.py": ["estimate_section"]},
        "estimate_windows": {
            "ingest/codec.py": ["decode"],
            "estimation/motion/mileage.py": ["Gates.__post_init__"],
        },
    }
    assert entered_files(traced) == {"ingest/codec.py": "ingest, estimate_windows"}


NUMBERS = """
MOST, LEAST = 3.0, -2
ALWAYS = frozen(np.array([0.5, 1.0]), (2,))
NONE = Check(0.0)
STEP = StepModel(slope=0.1)
Share = Annotated[float, Interval(ge=0.0, le=0.9)]
FIRST = MANY[2]
class Found:
    count: int = 0
    width: float = 0.4
@dataclass(frozen=True)
class ScreenParameters:
    most: float = 4.0
def refined(count=12, step=1.0, *, tolerance=1e-6): ...
"""


def test_a_number_is_loose_outside_values_of_parameters(tmp_path: Path) -> None:
    (tmp_path / "estimation").mkdir()
    (tmp_path / "estimation" / "screen.py").write_text(NUMBERS, encoding="utf-8")
    found = {item.name for item in loose_constants(tmp_path)}
    assert found == {"MOST", "LEAST", "ALWAYS", "width", "refined(count)", "refined(tolerance)"}


def test_few_numbers_are_loose() -> None:
    assert len(list(loose_constants(ROOT))) <= 85
