"""Print as JSON how many SQL statements each job executes in one run of all, in the order in which they run.

``python -P bench/job_statements.py`` in the environment of a deployment that has received its recordings. What
``treadwatch estimate`` executes before the first job and after the last one, such as reading settings, beginning and
ending its lease and summing up, stands apart as ``start`` and ``end``: it is the same however many jobs run. With
``--list`` the statements are printed instead.
"""

from __future__ import annotations

import contextlib
import json
import sys
import threading

from sqlalchemy import Engine, event

from api.cli import main as command_line
from api.terminal import estimate
from estimation.jobs.job import Job, JobContext, JobRun, JobTrigger

START, END = "start", "end"


def main() -> None:
    """Run all jobs and print their statements."""
    executed: dict[str, list[str]] = {START: []}
    running, run_job = START, estimate.run_job

    def note(_connection: object, _cursor: object, statement: str, *_: object) -> None:
        if threading.current_thread() is threading.main_thread():  # not what prolongs the lease now and then
            executed.setdefault(running, []).append(" ".join(statement.split()))

    def run_counted(job: Job, context: JobContext, trigger: JobTrigger) -> JobRun:
        nonlocal running
        running = job.name
        try:
            return run_job(job, context, trigger)
        finally:
            running = END

    estimate.run_job = run_counted
    event.listen(Engine, "before_cursor_execute", note)
    listed = "--list" in sys.argv
    with contextlib.redirect_stdout(sys.stderr), contextlib.suppress(SystemExit):
        sys.argv = ["treadwatch", "estimate"]
        command_line()
    print(json.dumps(executed if listed else {name: len(statements) for name, statements in executed.items()}))


if __name__ == "__main__":
    main()
