"""The rule of the page, set by a rules file, raises an alert in the job; the API lists its kind."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path

from wheelset_life import DAY_NS, START_NS, SetClock, register, run_windows, wear

import estimation
from api.app import document_text
from api.rules_file import load_rules
from estimation.jobs import evaluate_alerts
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.values.runs import JobTrigger
from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

folder = Path(sys.argv[1])
rules = folder / "rules.toml"
rules.write_text("[uncertain_conicity]\nraise_std = 0.0001\nclear_std = 0.00005\n", encoding="utf-8")
url = f"sqlite:///{folder}/treadwatch.sqlite"
upgrade(url)
with closing(SqlStorage(database_engine(url), folder)) as storage:
    register(storage, "W1")
    wear(storage, "W1", 20)
    run_windows(storage, "W1", 19.5, 20)
    clock = SetClock(START_NS + round(20.5 * DAY_NS))
    context = JobContext(storage, clock, "test", JobSettings(rules=load_rules(rules)))
    run = run_job(evaluate_alerts.JOB, context, JobTrigger.CLI)
    assert run.error is None, run.error
    with storage.read() as unit:
        kinds = [alert.kind for alert in unit.alerts.all_open("W1")]
assert kinds == ["uncertain_conicity"], kinds
assert '"uncertain_conicity"' in document_text()
assert "UncertainConicityEvidence" in document_text()
print(estimation.__file__)  # noqa: T201 - for the test: which copy ran
