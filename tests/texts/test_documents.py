"""The pages for operators agree with the code."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from api.problems import TYPES
from api.settings import PREFIX, Settings
from estimation.values.reasons import ReasonCode

DOCS = Path(__file__).parents[2] / "docs"


def test_every_setting_is_described_with_its_default() -> None:
    rows = re.findall(r"^\| `(TREADWATCH_\w+)` \| (.*?) \|", (DOCS / "settings.md").read_text(), re.MULTILINE)
    assert {name for name, _ in rows} == {f"{PREFIX}{name.upper()}" for name in Settings.model_fields}
    for name, shown in rows:
        default = Settings.model_fields[name.removeprefix(PREFIX).lower()].default
        if shown.startswith("`"):
            assert shown.strip("`") == (f"{default:g}" if isinstance(default, float) else str(default)), name
        else:
            assert default is None, name


def test_every_type_of_problem_is_described() -> None:
    described = re.findall(r"`urn:treadwatch:problem:([\w-]+)`", (DOCS / "problems.md").read_text())
    assert set(described) == set(TYPES)


def test_every_reason_code_has_a_meaning_and_a_remedy() -> None:
    pages = "".join(
        (DOCS / name).read_text()
        for name in (
            *("troubleshooting.md", "sections.md", "quarantine.md", "plausibility.md", "worklist.md", "recordings.md"),
            *("measured-against-estimated.md", "purged-windows.md", "second-opinions.md"),
        )
    )
    assert {code for code in ReasonCode if not re.search(rf"^\|.*`{code}`", pages, re.MULTILINE)} == set()


MEASURES = "".join((DOCS / name).read_text() for name in ("operations.md", "http-service.md"))


@pytest.mark.parametrize("measure", re.findall(r"`(treadwatch_\w+)`", MEASURES))
def test_every_measure_that_is_described_exists(measure: str) -> None:
    folder = Path(__file__).parents[2] / "api"
    source = "".join((folder / name).read_text() for name in ("metrics.py", "http_server.py"))
    assert f'"{measure.removesuffix("_total")}"' in source
