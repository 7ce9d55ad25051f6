"""``treadwatch ingest``: receive recordings from files, or listen to a live bus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from estimation.errors import ParameterError
from ingest.logs import SUFFIXES


def ingest(
    files: Annotated[
        list[Path] | None, typer.Argument(help=f"Recordings ({', '.join(SUFFIXES)}), or folders of them.")
    ] = None,
    *,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle of the recordings; by default the part of the file name before '__'.")
    ] = None,
    registry: Annotated[
        Path | None, typer.Option(help="Registry to load first: fleets, vehicles, wheelsets, sections.")
    ] = None,
    interface: Annotated[
        str | None, typer.Option(help="Listen to a live bus: virtual, udp_multicast or socketcan.")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Channel of the live bus, such as 239.74.163.2 or can0.")] = None,
    chunk_seconds: Annotated[float, typer.Option(min=1.0, help="Length of a recording cut from a live bus.")] = 60.0,
) -> None:
    """Receive CAN recordings of vehicles, from log files or a live bus, and cut them into windows.

    Every recording is stored unchanged before it is decoded. Receiving a recording twice changes nothing.
    """
    if (interface is None) == (not files):
        raise ParameterError("give recordings, or --interface with --channel and --vehicle", field="FILES")
    from api.terminal.ingest import LiveBus, ingest_and_report

    if interface is None:
        source: list[Path] | LiveBus = files or []
    elif channel is None or vehicle is None:
        raise ParameterError("a live bus needs --channel and --vehicle", field="--interface")
    else:
        source = LiveBus(interface, channel, chunk_seconds)
    ingest_and_report(source, vehicle, registry)
