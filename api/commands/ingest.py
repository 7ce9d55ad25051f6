"""``treadwatch ingest``: receive recordings from files, or listen to a live bus."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimation.errors import ParameterError
from ingest.logs import SUFFIXES

if TYPE_CHECKING:
    from api.terminal.live import LiveBus


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
    bus: Annotated[
        list[str] | None,
        typer.Option(help="CHANNEL=VEHICLE of --interface, in place of --channel and --vehicle. May be repeated."),
    ] = None,
    exchange: Annotated[
        list[Path] | None,
        typer.Option(help="Exchange of simulated or measured runs: a TOML file beside its table. May be repeated."),
    ] = None,
    catalogue: Annotated[
        list[Path] | None,
        typer.Option(help="Mapping file of a bus of your own, beside its DBC file; by default TREADWATCH_CATALOGUES."),
    ] = None,
    take_deleted: Annotated[
        bool, typer.Option("--take-deleted", help="Take recordings in again that were deleted.")
    ] = False,
    chunk_seconds: Annotated[float, typer.Option(min=1.0, help="Length of a recording cut from a live bus.")] = 60.0,
    health_port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Serve /healthz, /readyz and /metrics of a live bus here.")
    ] = None,
    health_host: Annotated[str, typer.Option(help="Address of the health port.")] = "127.0.0.1",
) -> None:
    """Receive CAN recordings of vehicles, from log files or a live bus, and cut them into windows.

    Every recording is stored unchanged before it is decoded. Receiving a recording twice changes nothing. Runs from a
    simulation or of an instrumented vehicle come in as exchanges. What a live bus sends is on the disk within a second.
    """
    sources = (interface is not None) + bool(files) + bool(exchange)
    if sources > 1 or (sources == 0 and registry is None):  # a registry may come alone
        raise ParameterError(
            "give recordings, or --exchange, or --interface with --channel and --vehicle, or --bus", field="FILES"
        )
    from api.terminal.health_server import HealthAddress
    from api.terminal.ingest import Exchanges, ingest_and_report
    from api.terminal.live import receive_and_report

    if exchange and vehicle is not None:
        raise ParameterError("an exchange names its vehicle itself", field="--vehicle")
    if interface is None:
        source = Exchanges(tuple(exchange)) if exchange else files or []
        ingest_and_report(source, vehicle, registry, catalogue or (), take_deleted=take_deleted)
        return
    buses = _buses(interface, channel, vehicle, bus or (), chunk_seconds)
    health = None if health_port is None else HealthAddress(health_host, health_port)
    receive_and_report(buses, registry, catalogue or (), health)


def _buses(
    interface: str, channel: str | None, vehicle: str | None, more: Sequence[str], chunk_seconds: float
) -> list[LiveBus]:
    from api.terminal.live import LiveBus

    if more and (channel is not None or vehicle is not None):
        raise ParameterError("names channel and vehicle itself: leave --channel and --vehicle out", field="--bus")
    if not more and (channel is None or vehicle is None):
        raise ParameterError("a live bus needs --channel and --vehicle, or --bus CHANNEL=VEHICLE", field="--interface")
    pairs = [one.partition("=")[::2] for one in more] or [(channel or "", vehicle or "")]
    if not all(one and of for one, of in pairs):
        raise ParameterError("is CHANNEL=VEHICLE, such as can0=L-1", field="--bus")
    if min(len({one for one, _ in pairs}), len({of for _, of in pairs})) < len(pairs):
        raise ParameterError("a channel or a vehicle is there twice", field="--bus")
    return [LiveBus(interface, one, of, chunk_seconds) for one, of in pairs]
