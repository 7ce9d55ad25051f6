"""The number of the page is measured, stored and served with every window, and its rule raises an alert."""

from __future__ import annotations

import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from wheelset_life import DAY_NS, START_NS, WINDOW_NS, SetClock, quality, register, sample_window

import estimation
from api.app import document_text
from estimation.jobs import evaluate_alerts
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.values.runs import JobTrigger
from fleet_db.migrate import upgrade
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

folder = Path(sys.argv[1])
url = f"sqlite:///{folder}/treadwatch.sqlite"
upgrade(url)
start = START_NS // WINDOW_NS * WINDOW_NS + 20 * DAY_NS
with closing(SqlStorage(database_engine(url), folder)) as storage:
    register(storage, "W1", "W2")
    with storage.write() as unit:
        for wheelset, rms in (("W1", 6.0), ("W2", 4.0)):
            for number in range(20):
                of_window = replace(quality(), lateral_rms_m_s2=rms)
                at_ns = start + number * WINDOW_NS
                unit.windows.put(sample_window(wheelset, at_ns, odometer_m=1e6, quality=of_window), 20_000.0, 1)
    with storage.read() as unit:
        assert unit.windows.get("W1", start).quality.lateral_rms_m_s2 == 6.0
        assert unit.windows.load("W1", start).quality.lateral_rms_m_s2 == 6.0
    context = JobContext(storage, SetClock(start + DAY_NS), "test", JobSettings())
    run = run_job(evaluate_alerts.JOB, context, JobTrigger.CLI)
    assert run.error is None, run.error
    with storage.read() as unit:
        kinds = {serial: [alert.kind for alert in unit.alerts.all_open(serial)] for serial in ("W1", "W2")}
assert kinds == {"W1": ["rough_ride"], "W2": []}, kinds
assert '"lateral_rms_m_s2"' in document_text()
assert "RoughRideEvidence" in document_text()
print(estimation.__file__)  # noqa: T201 - for the test: which copy ran
