"""Print as JSON how many SQL statements each job executes, in the order in which they run.

``python -P bench/job_statements.py`` in the environment of a deployment that has received its recordings.
"""

from __future__ import annotations

import contextlib
import json
import sys
from collections import Counter

from sqlalchemy import Engine, event

from api.cli import main as command_line
from estimation.jobs.catalogue import ALL_JOBS


def main() -> None:
    """Run the jobs one by one and print their statements."""
    executed: Counter[str] = Counter()
    running = ""

    def count(*_: object) -> None:
        executed[running] += 1

    event.listen(Engine, "before_cursor_execute", count)
    with contextlib.redirect_stdout(sys.stderr):
        for job in ALL_JOBS:
            running = job.name
            sys.argv = ["treadwatch", "estimate", "--job", running]
            with contextlib.suppress(SystemExit):
                command_line()
    print(json.dumps(executed))


if __name__ == "__main__":
    main()
