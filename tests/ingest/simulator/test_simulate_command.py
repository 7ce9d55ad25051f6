"""``treadwatch simulate`` as a person runs it."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenario_text import SMALL
from typer.testing import CliRunner

from api.cli import build
from estimation.errors import InputError


def run(*arguments: str) -> tuple[int, str]:
    result = CliRunner().invoke(build(["simulate"]), ["simulate", *arguments])
    if isinstance(result.exception, InputError):
        raise result.exception
    return result.exit_code, result.output


@pytest.fixture
def small(tmp_path: Path) -> str:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return str(path)


def test_the_list_names_the_built_in_scenarios() -> None:
    code, output = run("--list")
    assert code == 0
    assert all(name in output for name in ("demo", "live", "mems", "paper"))


def test_recordings_registry_and_truth_are_written(small: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, output = run("--scenario", small, "--out", str(out), "--workers", "1", "--seed", "8")
    assert code == 0
    assert "2 recordings" in output
    assert sorted(path.name for path in out.rglob("*") if path.is_file()) == [
        "V-1__20240108T053000Z.blf",
        "V-1__20240417T053000Z.blf",
        "registry.json",
        "s-9.csv",
        "truth.json",
    ]


def test_the_registry_alone_is_written_for_a_live_bus(small: str, tmp_path: Path) -> None:
    code, _ = run("--scenario", small, "--out", str(tmp_path / "out"), "--registry-only")
    assert code == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["registry.json", "s-9.csv"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "--out"),
        (["--scenario", "nowhere"], "no built-in scenario"),
        (["--interface", "virtual"], "--channel"),
        (["--interface", "virtual", "--channel", "x"], "N-101, N-102, N-103"),
        (["--interface", "virtual", "--channel", "x", "--vehicle", "N-9"], "no vehicle 'N-9'"),
        (["--interface", "tin-cans", "--channel", "x", "--vehicle", "N-101"], "interface"),
    ],
)
def test_what_cannot_be_done_is_said(arguments: list[str], words: str) -> None:
    with pytest.raises(InputError) as refused:
        run(*arguments)
    assert words in str(refused.value)
