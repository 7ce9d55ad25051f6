"""``treadwatch simulate``: a simulated fleet writes recordings, or one of its vehicles speaks on a live bus."""

from __future__ import annotations

import threading
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn
from rich.table import Table

from estimation.errors import ParameterError
from estimation.jobs.scheduler import stop_on_signals
from ingest.bus import INTERFACES, open_bus
from ingest.simulator.fleet import FleetReport, Recording, prepare, run_fleet
from ingest.simulator.live import speak
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import builtin_scenarios, load_scenario


def simulate(
    scenario: Annotated[str, typer.Option(help="A built-in scenario by name, or a TOML file.")] = "demo",
    *,
    out: Annotated[Path | None, typer.Option(help="Folder for recordings, registry and truth.")] = None,
    vehicle: Annotated[
        list[str] | None, typer.Option(help="Only this vehicle; may be repeated for recordings. Live: exactly one.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Instead of the scenario's seed.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; as many as cores unless given.")] = None,
    registry_only: Annotated[bool, typer.Option("--registry-only", help="Write registry and track, and end.")] = False,
    interface: Annotated[str | None, typer.Option(help=f"Speak on a live bus: {', '.join(INTERFACES)}.")] = None,
    channel: Annotated[str | None, typer.Option(help="Channel of the live bus, such as 239.74.163.2 or can0.")] = None,
    speed_up: Annotated[float, typer.Option(help="Pace of a live bus; a receiver takes real time only.")] = 1.0,
    list_scenarios: Annotated[bool, typer.Option("--list", help="List the built-in scenarios and end.")] = False,
) -> None:
    """Let a simulated fleet speak CAN frames: into recordings (--out), or live (--interface and --channel)."""
    if list_scenarios:
        Console().print(scenario_table())
        return
    plan = load_scenario(scenario)
    if seed is not None:
        plan = replace(plan, seed=seed)
    console = Console(stderr=True)
    if interface is None and out is None:
        raise ParameterError("give --out for recordings, or --interface with --channel for a live bus", field="--out")
    if out is not None and (registry_only or interface is not None):
        console.print(f"wrote {prepare(plan, out)}", highlight=False, soft_wrap=True)
    if registry_only:
        return
    if interface is not None:
        _live(plan, interface, channel, vehicle, speed_up, console)
    elif out is not None:
        report = simulate_with_progress(plan, out, console, vehicles=vehicle, workers=workers)
        console.print(
            f"{len(report.recordings)} recordings, {report.frames:,} frames, {report.wheelset_seconds:,.0f} "
            f"wheelset-seconds in {out}; registry {report.registry.name}, truth {report.truth.name}",
            highlight=False,
            soft_wrap=True,
        )


def simulate_with_progress(
    scenario: Scenario,
    out: Path,
    console: Console,
    *,
    vehicles: list[str] | None = None,
    workers: int | None = None,
) -> FleetReport:
    """Simulate a scenario into ``out`` under a bar of progress; arguments and errors as ``run_fleet``."""
    columns = (
        SpinnerColumn(),
        TextColumn("simulating the fleet"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[frames]:,} frames"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("", total=None, frames=0)
        frames = 0

        def show(done: int, total: int, recording: Recording) -> None:
            nonlocal frames
            frames += recording.frames
            progress.update(task, completed=done, total=total, frames=frames)

        return run_fleet(scenario, out, vehicles=vehicles, workers=workers, progress=show)


def scenario_table() -> Table:
    """Return the built-in scenarios and what they are."""
    table = Table("scenario", "vehicles", "wheelsets", "campaigns", "minutes each", "description")
    for name in builtin_scenarios():
        plan = load_scenario(name)
        table.add_row(
            name,
            str(len(plan.vehicles)),
            str(sum(len(vehicle.wheelsets) for vehicle in plan.vehicles)),
            str(plan.sessions.campaigns),
            f"{plan.sessions.duration / 60.0:g}",
            plan.description,
        )
    return table


def _live(
    scenario: Scenario,
    interface: str,
    channel: str | None,
    vehicles: list[str] | None,
    speed_up: float,
    console: Console,
) -> None:
    if channel is None:
        raise ParameterError("a live bus needs --channel", field="--channel")
    codes = vehicles or [plan.code for plan in scenario.vehicles]
    if len(codes) != 1:
        raise ParameterError(f"one bus is one vehicle; choose one of {', '.join(codes)}", field="--vehicle")
    scenario.vehicle(codes[0])
    stop = threading.Event()
    stop_on_signals(stop)
    with open_bus(interface, channel) as bus:
        console.print(f"{codes[0]} speaks on {interface} {channel}; stop with Ctrl-C", highlight=False)

        def show(campaign: int, sent: int) -> None:
            total = scenario.sessions.campaigns
            console.print(f"campaign {campaign} of {total}, {sent:,} frames so far", highlight=False)

        sent = speak(scenario, bus, codes[0], speed_up=speed_up, stop=stop, progress=show)
    console.print(f"{sent:,} frames sent", highlight=False)
