"""A simulated fleet writes recordings, or one of its vehicles transmits on a live bus; with progress."""

from __future__ import annotations

import threading
from pathlib import Path

from rich.console import Console
from rich.table import Table

from api.terminal.progress import bar
from api.terminal.stopping import stop_on_signals
from api.terminal.store import print_line
from estimation.errors import ParameterError
from ingest.live.listening import open_bus
from ingest.simulator.drawn_fleet import with_seed
from ingest.simulator.fleet import FleetReport, Recording, prepare, run_fleet, transmit
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import builtin_scenarios, load_scenario


def load(scenario: str, seed: int | None) -> Scenario:
    """Return a built-in scenario or that of a file, with another seed where one is given."""
    plan = load_scenario(scenario)
    return plan if seed is None else with_seed(plan, seed)


def write_registry(scenario: Scenario, out: Path) -> None:
    """Write registry and track of a scenario into the folder ``out``."""
    print_line(Console(stderr=True), f"wrote {prepare(scenario, out)}")


def write_recordings(scenario: Scenario, out: Path, vehicles: list[str] | None, workers: int | None) -> None:
    """Simulate a scenario, or some of its ``vehicles``, into a folder; None is all, and as many processes as cores."""
    console = Console(stderr=True)
    report = simulate_with_progress(scenario, out, console, vehicles=vehicles, workers=workers)
    print_line(
        console,
        f"{len(report.recordings)} recordings, {report.frames:,} frames, {report.wheelset_seconds:,.0f} "
        f"wheelset-seconds in {out}; registry {report.registry.name}, truth {report.truth.name}",
    )


def simulate_with_progress(
    scenario: Scenario, out: Path, console: Console, *, vehicles: list[str] | None = None, workers: int | None = None
) -> FleetReport:
    """Simulate a scenario into ``out`` under a progress bar; arguments and errors as ``run_fleet``."""
    with bar(console, "simulating the fleet", "{task.fields[frames]:,} frames") as progress:
        task = progress.add_task("", total=None, frames=0)
        frames = 0

        def show(done: int, total: int, recording: Recording) -> None:
            nonlocal frames
            frames += recording.frames
            progress.update(task, completed=done, total=total, frames=frames)

        return run_fleet(scenario, out, vehicles=vehicles, workers=workers, progress=show)


def list_scenarios() -> None:
    """Print the built-in scenarios with their size and description."""
    table = Table("scenario", "vehicles", "wheelsets", "campaigns", "minutes each", "description")
    for name in builtin_scenarios():
        plan = load_scenario(name)
        table.add_row(
            name,
            str(len(plan.vehicles)),
            str(sum(len(vehicle.wheelsets) for vehicle in plan.vehicles)),
            str(plan.sessions.campaigns),
            f"up to {plan.sessions.duration / 60.0:.0f}"
            if plan.sessions.whole_section
            else f"{plan.sessions.duration / 60.0:g}",
            plan.description,
        )
    Console().print(table)


def transmit_live(
    scenario: Scenario, interface: str, channel: str | None, vehicles: list[str] | None, speed_up: float
) -> None:
    """Transmit one vehicle of a scenario on a live bus until its last campaign ends or a signal comes."""
    console = Console(stderr=True)
    if channel is None:
        raise ParameterError("a live bus needs --channel", field="--channel")
    codes = vehicles or [plan.code for plan in scenario.vehicles]
    if len(codes) != 1:
        raise ParameterError(f"one bus is one vehicle; choose one of {', '.join(codes)}", field="--vehicle")
    scenario.vehicle(codes[0])
    stop = threading.Event()
    stop_on_signals(stop)
    with open_bus(interface, channel) as bus:
        console.print(f"{codes[0]} transmits on {interface} {channel}; stop with Ctrl-C", highlight=False)

        def show(campaign: int, sent: int) -> None:
            total = scenario.sessions.campaigns
            console.print(f"campaign {campaign} of {total}, {sent:,} frames so far", highlight=False)

        sent = transmit(scenario, bus, codes[0], speed_up=speed_up, stop=stop, progress=show)
    console.print(f"{sent:,} frames sent", highlight=False)
