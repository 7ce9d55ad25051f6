"""The stage of the page makes a result, makes another where its inputs change, and the API answers with it."""

from __future__ import annotations

import sys
from contextlib import closing
from pathlib import Path

import httpx
from running_service import running
from wheelset_life import DAY_NS, START_NS, SetClock, register

import api
import estimation
from api.app import document_text
from api.factory import open_store
from api.settings import Settings
from estimation.jobs.catalogue import job_named
from estimation.jobs.job import JobContext, run_job
from estimation.jobs.settings import JobSettings
from estimation.storage import Storage
from estimation.values.registry import Reprofiling
from estimation.values.runs import JobTrigger
from fleet_db.migrate import upgrade


def counts(storage: Storage) -> dict[str, int]:
    context = JobContext(storage, SetClock(START_NS + 100 * DAY_NS), "test", JobSettings())
    run = run_job(job_named("refresh_turning"), context, JobTrigger.CLI)
    assert run.error is None, run.error
    return dict(run.counts)


Path(api.__file__).with_name("openapi.json").write_text(document_text(), encoding="utf-8")  # as ``openapi --write``
settings = Settings(data_dir=Path(sys.argv[1]), port=0, access="open", log_level="warning", _env_file=None)
upgrade(settings.url)
with closing(open_store(settings)) as storage:
    register(storage, "W1", "W2")
    assert counts(storage) == {"wheelsets": 2, "refreshed": 2, "unchanged": 0, "quarantined": 0}
    with storage.write() as unit:
        unit.registry.add_reprofiling(Reprofiling("W1", START_NS + 30 * DAY_NS, 30_000.0))
        unit.registry.add_reprofiling(Reprofiling("W1", START_NS + 80 * DAY_NS, 80_000.0))
    assert counts(storage) == {"wheelsets": 2, "refreshed": 1, "unchanged": 1, "quarantined": 0}
    assert counts(storage) == {"wheelsets": 2, "refreshed": 0, "unchanged": 2, "quarantined": 0}
    with running(settings) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        found = client.get("/v1/wheelsets/W1/turning").json()
        assert (found["visits"], found["mean_km"]) == (2, 40_000.0), found
        assert client.get("/v1/wheelsets/W2/turning").json()["mean_km"] is None
        assert client.get("/v1/wheelsets/W3/turning").status_code == 404
print(estimation.__file__)  # noqa: T201 - for the test: which copy ran
