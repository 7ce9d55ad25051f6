"""Compiled code is kept between processes, in a directory that is named, and nothing about that directory does harm."""

from __future__ import annotations

import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from api.cli import LEVEL_3, choose_compiled_code, portable_cpu

ROOT = Path(__file__).parents[2]
WITHOUT_PRIVILEGE = ("setpriv", "--bounding-set=-dac_override") if os.geteuid() == 0 else ()
"""Permissions hold for root too."""
PROGRAM = """
import json, os
from api.cli import choose_compiled_code
choose_compiled_code(os.environ)
from estimation.motion.integration import integrate_once
import numpy as np
found = np.empty(3)
integrate_once(np.ones(3), 0.5, found)
stats = integrate_once.stats
print(json.dumps([sum(stats.cache_hits.values()), sum(stats.cache_misses.values()), found.tolist()]))
"""


class Planted:
    """What makes a directory when it is unpickled."""

    def __init__(self, made: Path) -> None:
        self.made = str(made)

    def __reduce__(self) -> tuple[object, tuple[str]]:
        """Return the call that unpickling makes."""
        return os.mkdir, (self.made,)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a copy of the packages that nobody may write."""
    folder = tmp_path_factory.mktemp("installed")
    for package in ("api", "ingest", "fleet_db", "estimation"):
        shutil.copytree(ROOT / package, folder / package, ignore=shutil.ignore_patterns("__pycache__"))
    for path in [folder, *folder.rglob("*")]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    return folder


def run(
    installed: Path, *, home: str = "none", program: str = PROGRAM, **settings: str
) -> subprocess.CompletedProcess[str]:
    """Run a program of the copy as somebody who may write where permissions say so; its home is below the copy."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("NUMBA_C", "XDG_", "TREADWATCH"))}
    environment = (
        kept | {"PYTHONPATH": str(installed), "HOME": str(installed / home), "PYTHONDONTWRITEBYTECODE": "1"} | settings
    )
    return subprocess.run(
        [*WITHOUT_PRIVILEGE, sys.executable, "-c", program], cwd=installed, env=environment, capture_output=True,
        text=True, check=False,
    )  # fmt: skip


LOADED, COMPILED = [1, 0], [0, 1]


def counts(done: subprocess.CompletedProcess[str]) -> list[int]:
    """Return how many signatures a run loaded, and how many it compiled."""
    assert done.returncode == 0, done.stderr
    *found, values = json.loads(done.stdout)
    assert values == [0.0, 0.5, 1.0]
    return [int(number) for number in found]


@pytest.fixture
def writable(tmp_path: Path) -> Path:
    """Return a directory that can be written."""
    folder = tmp_path / "compiled"
    folder.mkdir()
    return folder


def test_a_read_only_install_without_a_home_runs_and_warns_once(installed: Path) -> None:
    done = run(installed)
    assert counts(done) == COMPILED
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"compiled code cannot be kept in {installed}/none/.cache/treadwatch/compiled")
    assert "TREADWATCH_COMPILED_DIR" in line


def test_what_was_compiled_is_loaded_from_a_directory_that_can_only_be_read(installed: Path, writable: Path) -> None:
    assert counts(run(installed, TREADWATCH_COMPILED_DIR=str(writable))) == COMPILED
    for path in [*writable.rglob("*"), writable]:
        path.chmod(0o555 if path.is_dir() else 0o444)
    done = run(installed, TREADWATCH_COMPILED_DIR=str(writable))
    assert (counts(done), done.stderr) == (LOADED, "")


@pytest.mark.slow
def test_the_default_is_the_users_directory_for_caches(installed: Path, writable: Path) -> None:
    assert counts(run(installed, home=str(writable))) == COMPILED
    assert len(list((writable / ".cache/treadwatch/compiled").glob("*.nbc"))) == 1
    other = writable / "elsewhere"
    assert counts(run(installed, XDG_CACHE_HOME=str(other))) == COMPILED
    assert len(list((other / "treadwatch/compiled").glob("*.nbc"))) == 1


@pytest.mark.slow
def test_another_cpu_compiles_its_own_and_leaves_the_other(installed: Path, writable: Path) -> None:
    run(installed, TREADWATCH_COMPILED_DIR=str(writable))
    foreign = run(installed, TREADWATCH_COMPILED_DIR=str(writable), NUMBA_CPU_NAME="generic", NUMBA_CPU_FEATURES="")
    assert counts(foreign) == COMPILED
    assert counts(run(installed, TREADWATCH_COMPILED_DIR=str(writable))) == LOADED


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", ["cut", "emptied", "other content", "a directory"])
def test_a_damaged_file_stops_nothing(installed: Path, writable: Path, damage: str, suffix: str) -> None:
    run(installed, TREADWATCH_COMPILED_DIR=str(writable))
    (file,) = writable.rglob(f"*{suffix}")
    content = file.read_bytes()
    if damage == "a directory":
        file.unlink()
        file.mkdir()
    else:
        file.write_bytes({"cut": content[: len(content) // 2], "emptied": b"", "other content": b"x" * 99}[damage])
    writable.joinpath("compiled").chmod(0o555)
    done = run(installed, TREADWATCH_COMPILED_DIR=str(writable))
    assert (counts(done), done.stderr.count("compiled code cannot be kept")) == (COMPILED, 1)
    writable.joinpath("compiled").chmod(0o755)
    done = run(installed, TREADWATCH_COMPILED_DIR=str(writable))
    assert "Traceback" not in done.stderr
    assert counts(done) == COMPILED
    if damage != "a directory":
        assert counts(run(installed, TREADWATCH_COMPILED_DIR=str(writable))) == LOADED


@pytest.mark.slow
def test_a_bit_that_has_turned_anywhere_ends_no_process(installed: Path, writable: Path) -> None:
    run(installed, TREADWATCH_COMPILED_DIR=str(writable))
    (file,) = writable.rglob("*.nbc")
    content = file.read_bytes()
    for place in np.linspace(200, len(content) - 200, 9).astype(int):
        file.write_bytes(content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :])
        done = run(installed, TREADWATCH_COMPILED_DIR=str(writable))
        assert (counts(done), done.stderr) == (COMPILED, ""), place


@pytest.mark.slow
@pytest.mark.parametrize("what", ["compiled", "compiled/*.nbi", "compiled/*.nbc"])
def test_code_that_everybody_may_write_is_not_loaded(installed: Path, writable: Path, what: str) -> None:
    run(installed, TREADWATCH_COMPILED_DIR=str(writable))
    (path,) = writable.glob(what)
    (index,) = writable.rglob("*.nbi")
    (index if path.is_dir() else path).write_bytes(pickle.dumps(Planted(writable / "ran")))
    path.chmod(0o777)
    assert counts(run(installed, TREADWATCH_COMPILED_DIR=str(writable))) == COMPILED
    assert not (writable / "ran").exists()
    # files are replaced, and then serve; a directory stays as it is
    again = counts(run(installed, TREADWATCH_COMPILED_DIR=str(writable)))
    assert again == (COMPILED if path.is_dir() else LOADED)


@pytest.mark.slow
def test_a_signature_under_the_name_of_another_is_not_taken(installed: Path, writable: Path) -> None:
    """Two processes that write at once may leave such an index."""
    program = PROGRAM.replace("integrate_once(np.ones(3)", "integrate_once(np.frombuffer(np.ones(3).tobytes())")
    for one in (PROGRAM, program):
        assert counts(run(installed, program=one, TREADWATCH_COMPILED_DIR=str(writable))) == COMPILED
    first, second = sorted(writable.rglob("*.nbc"))
    second.write_bytes(first.read_bytes())
    assert counts(run(installed, program=PROGRAM, TREADWATCH_COMPILED_DIR=str(writable))) == LOADED
    assert counts(run(installed, program=program, TREADWATCH_COMPILED_DIR=str(writable))) == COMPILED


@pytest.mark.slow
def test_a_change_of_a_called_function_in_another_file_is_noticed(tmp_path: Path) -> None:
    program = "import caller\nprint(caller.twice(4), sum(caller.twice.stats.cache_hits.values()))"
    decorated = "from estimation.compiled import compiled\nFACTOR = 2\n@compiled()\n"
    (tmp_path / "called.py").write_text(f"{decorated}def times(x):\n    return FACTOR * x\n")
    (tmp_path / "caller.py").write_text(f"from called import times\n{decorated}def twice(x):\n    return times(x)\n")

    def said() -> str:
        environment = os.environ | {
            "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}",
            "PYTHONDONTWRITEBYTECODE": "1",
        }  # fmt: skip
        command = [sys.executable, "-c", program]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout

    assert [said(), said()] == ["8 0\n", "8 1\n"]
    source = (tmp_path / "called.py").read_text()
    (tmp_path / "called.py").write_text(source.replace("FACTOR = 2", "FACTOR = 3"))
    assert said() == "12 0\n"


def test_portable_code_is_for_what_all_servers_have(tmp_path: Path) -> None:
    facts = tmp_path / "cpuinfo"
    facts.write_text("processor : 0\nflags\t\t: fpu avx2 fma bmi1 bmi2 f16c abm movbe avx512f\n")
    assert portable_cpu("x86_64", facts) == LEVEL_3
    assert portable_cpu("aarch64", facts) == ("generic", "")
    facts.write_text("flags\t\t: fpu avx2 bmi1 bmi2 f16c abm movbe\n")
    assert portable_cpu("x86_64", facts) == ("generic", "")
    assert portable_cpu("x86_64", tmp_path / "nothing") == ("generic", "")


def test_settings_come_from_the_environment_before_the_file(tmp_path: Path) -> None:
    file = tmp_path / ".env"
    file.write_text("TREADWATCH_COMPILED_DIR=/of/file\nTREADWATCH_COMPILED_CPU=portable\n")
    of_file: dict[str, str] = {}
    choose_compiled_code(of_file, file)
    assert of_file["NUMBA_CACHE_DIR"] == "/of/file"
    assert (of_file["NUMBA_CPU_NAME"], of_file["NUMBA_CPU_FEATURES"]) == portable_cpu()
    both = {"TREADWATCH_COMPILED_DIR": "/of/environment", "NUMBA_CPU_NAME": "znver4"}
    choose_compiled_code(both, file)
    assert both["NUMBA_CACHE_DIR"] == "/of/environment"
    assert both["NUMBA_CPU_NAME"] == "znver4"
    assert "NUMBA_CPU_FEATURES" not in both
