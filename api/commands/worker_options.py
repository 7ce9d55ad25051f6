"""Options of the commands that run jobs: who does their work."""

from __future__ import annotations

from typing import Annotated

import typer

Workers = Annotated[
    str | None,
    typer.Option(
        help="Processes that estimate; auto is one for each processor.  [env var: TREADWATCH_WORKERS; default: 1]"
    ),
]
DaskScheduler = Annotated[
    str | None,
    typer.Option(
        help=(
            "Address of a Dask scheduler whose workers estimate instead.  "
            "[env var: TREADWATCH_DASK_SCHEDULER; default: none]"
        )
    ),
]
