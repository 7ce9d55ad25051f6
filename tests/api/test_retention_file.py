"""How long what is kept, from a file."""

from __future__ import annotations

from pathlib import Path

import pytest
from in_process_command import Run

from api.settings import load_retention
from estimation.errors import InputError
from fleet_db.keeping.retention import Kept, Retention


def written(folder: Path, text: str) -> Path:
    path = folder / "retention.toml"
    path.write_text(text)
    return path


def test_what_is_not_written_keeps_its_default(tmp_path: Path) -> None:
    found = load_retention(written(tmp_path, '[days]\njob_runs = 3\nsuperseded_estimates = "for ever"\n'))
    assert found == Retention(job_runs=3.0, superseded_estimates=None)
    days = {kind.value: 40.0 + number for number, kind in enumerate(Kept)}
    everything = "\n".join(f"{kind} = {number}" for kind, number in days.items())
    assert load_retention(written(tmp_path, f"[days]\n{everything}\n")) == Retention(**days)


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("[days]\njob_runs = 0\n", "days.job_runs"),
        ('[days]\njob_runs = "always"\n', "days.job_runs"),
        ("[days]\nwindows = 3\n", "days.windows"),
        ("job_runs = 3\n", "days"),
        ("[days]\njob_runs = inf\n", "days.job_runs"),
        ("[days]\nrecordings = 30\n", "days.recordings"),
    ],
)
def test_what_cannot_be_used_is_named(tmp_path: Path, text: str, field: str) -> None:
    with pytest.raises(InputError) as caught:
        load_retention(written(tmp_path, text))
    assert (caught.value.field or "").startswith(field)


def test_by_command(treadwatch: Run, tmp_path: Path) -> None:
    assert treadwatch("db", "upgrade", data_dir="data").returncode == 0
    done = treadwatch("db", "purge", retention_file=str(written(tmp_path, '[days]\ntrack_reports = "for ever"\n')))
    assert (done.returncode, done.stdout.count("0 deleted")) == (0, len(Kept) - 2)
    refused = treadwatch("db", "purge", retention_file=str(written(tmp_path, "[days]\njob_runs = -1\n")))
    assert (refused.returncode, "days.job_runs" in refused.stderr) == (2, True)
