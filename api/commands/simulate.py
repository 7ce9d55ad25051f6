"""``treadwatch simulate``: a simulated fleet writes recordings, or one of its vehicles transmits on a live bus."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from estimation.errors import ParameterError


def simulate(
    scenario: Annotated[str, typer.Option(help="Name of a built-in scenario, or a TOML file.")] = "demo",
    *,
    out: Annotated[Path | None, typer.Option(help="Folder for recordings, registry and truth.")] = None,
    vehicle: Annotated[
        list[str] | None, typer.Option(help="Only this vehicle; may be repeated for recordings. Live: exactly one.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Replaces the scenario's seed.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; by default as many as cores.")] = None,
    registry_only: Annotated[bool, typer.Option("--registry-only", help="Write registry and track, and end.")] = False,
    interface: Annotated[
        str | None, typer.Option(help="Transmit on a live bus: virtual, udp_multicast or socketcan.")
    ] = None,
    channel: Annotated[str | None, typer.Option(help="Channel of the live bus, such as 239.74.163.2 or can0.")] = None,
    speed_up: Annotated[float, typer.Option(help="Pace of a live bus; a receiver takes real time only.")] = 1.0,
    list_scenarios: Annotated[bool, typer.Option("--list", help="List the built-in scenarios and end.")] = False,
) -> None:
    """Simulate a fleet that sends CAN frames: into recordings (--out), or live (--interface and --channel)."""
    from api.terminal import simulate as terminal

    if list_scenarios:
        terminal.list_scenarios()
        return
    plan = terminal.load(scenario, seed)
    if interface is None and out is None:
        raise ParameterError("give --out for recordings, or --interface with --channel for a live bus", field="--out")
    if out is not None and (registry_only or interface is not None):
        terminal.write_registry(plan, out)
    if registry_only:
        return
    if interface is not None:
        terminal.transmit_live(plan, interface, channel, vehicle, speed_up)
    elif out is not None:
        terminal.write_recordings(plan, out, vehicle, workers)
