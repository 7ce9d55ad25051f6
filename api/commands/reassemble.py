"""``treadwatch reassemble``: the windows of a vehicle, made again from what is stored of it."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

import typer

FORMATS = ["%Y-%m-%dT%H:%M:%S%z", "%Y-%m-%dT%H:%M:%S.%f%z", "%Y-%m-%d"]


def reassemble(
    *,
    vehicle: Annotated[str, typer.Option(help="Vehicle whose windows are made again.")],
    begin: Annotated[
        datetime | None,
        typer.Option("--from", formats=FORMATS, help="From this time of its clock, as in 2024-01-08T05:30:00Z."),
    ] = None,
    end: Annotated[datetime | None, typer.Option("--to", formats=FORMATS, help="To this time of its clock.")] = None,
) -> None:
    """Make the windows of a vehicle again from its recordings, the registry and the catalogue, and check their files.

    What is as it should be stays. Windows that changed wait to be estimated again; lost or damaged files are written
    again.
    """
    from api.terminal.reassemble import reassemble_and_report

    reassemble_and_report(vehicle, begin, end)
