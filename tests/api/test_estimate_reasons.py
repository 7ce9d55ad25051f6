"""``treadwatch estimate``: what it says of refused windows and of wheelsets without an estimate."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import api_fleet as fleet
import populated_fleet
import pytest
from typer.testing import CliRunner

from api.cli import build
from api.terminal.estimate import fleet_reasons, summary, summary_lines
from estimation.errors import ParameterError
from estimation.jobs.estimate_windows import refusals_text
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import JobOutcome, JobRun, JobTrigger
from estimation.values.windows import WindowState
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

COUNTS = {"estimated": 0, "refused": 96, "refused_position_uncertain": 16, "refused_alignment_unknown": 80}


@pytest.fixture
def deployment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sqlite_url: str) -> Iterator[SqlStorage]:
    """Point the settings at a database with the fleet of the API's tests, and yield its storage."""
    monkeypatch.setenv("TREADWATCH_DATABASE_URL", sqlite_url)
    monkeypatch.setenv("TREADWATCH_DATA_DIR", str(tmp_path / "data"))
    monkeypatch.setenv("COLUMNS", "200")
    storage = SqlStorage(database_engine(sqlite_url), tmp_path / "data")
    populated_fleet.populate(storage)
    with storage.write() as unit:
        for serial, code in ((fleet.WHEELSETS[2], ReasonCode.CLIPPED), (fleet.WHEELSETS[3], ReasonCode.SENSOR_FAULT)):
            for index in range(4 if code is ReasonCode.CLIPPED else 2):
                window = replace(fleet.window(index, serial), axle=2)
                unit.windows.put(window, 10.0, fleet.RECORDED)
                unit.windows.mark(serial, window.start_ns, WindowState.REFUSED, Reason(code, f"on {serial}"))
    yield storage
    storage.close()


def test_a_run_says_what_windows_were_refused_for() -> None:
    run = JobRun(1, "estimate_windows", JobTrigger.CLI, 0, 10**9, JobOutcome.SUCCEEDED, COUNTS)
    (cells,) = (list(column.cells) for column in summary([run]).columns[-1:])
    assert cells == ["0 estimated, 96 refused: 80 alignment_unknown, 16 position_uncertain"]
    assert refusals_text(COUNTS) == (
        "80 alignment_unknown (Survey it, or wait for more passes),"
        " 16 position_uncertain (Wait for more passes, or check the position source)"
    )
    assert refusals_text({"estimated": 3, "refused": 0}) == ""


def test_all_wheelsets_without_an_estimate_are_summed_by_reason(deployment: SqlStorage) -> None:
    with deployment.read() as unit:
        lines = summary_lines(fleet_reasons(unit))
    head, clipped, faulty, silent = lines
    assert head == "11 of 12 mounted wheelsets have no conicity at 3 mm; their newest windows, at most 1,000 of each:"
    assert clipped == f"  4 refused clipped: on {fleet.WHEELSETS[2]}. {ReasonCode.CLIPPED.remedy}"
    assert faulty.startswith("  2 refused sensor_fault: ")
    assert silent.startswith("  9 without a window, such as WS-001: no recording of V-0 has been received. Check")


def test_each_wheelset_is_listed_and_nothing_is_run(deployment: SqlStorage) -> None:
    result = CliRunner().invoke(build(["estimate"]), ["estimate", "--reasons"])
    assert result.exit_code == 0, result.output
    (line,) = (line for line in result.output.splitlines() if fleet.WHEELSETS[2] in line and "V-0" in line)
    assert "4 refused: on WS-002" in line
    assert "Check its mounting and range." in line
    with deployment.read() as unit:
        assert len(unit.jobs.page("refresh_geometry", None, 10)) == 0
    refused = CliRunner().invoke(build(["estimate"]), ["estimate", "--reasons", "--job", "estimate_windows"])
    assert isinstance(refused.exception, ParameterError)
