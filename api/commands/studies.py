"""Subcommands that simulate, compute and compare, on no deployment: demo, fleets, estimators, figures, contact."""

from __future__ import annotations

import json
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import orjson
import typer
from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from api.terminal.progress import bar
from estimation.contact.method import ContactMethod
from estimation.errors import ParameterError
from ingest.profiles.formats import format_names
from ingest.profiles.points import Origin


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


def demo(
    *,
    once: Annotated[bool, typer.Option("--once", help="End after the table instead of serving on.")] = False,
    scenario: Annotated[str, typer.Option(help="Name of a built-in scenario, or a TOML file.")] = "demo",
    folder: Annotated[Path, typer.Option(help="Where the demo keeps its files; emptied at each start.")] = Path(
        "treadwatch-data/demo"
    ),
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the API; another if it is taken.")] = 8000,
) -> None:
    """Simulate a fleet on CAN, receive it, estimate it, and serve trends and alerts."""
    from api.terminal.demo import run_demo

    run_demo(scenario, folder, port, keep_serving=not once)


def _make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ParameterError(f"{out}: no folder can be made there: {error.strerror}", field="--out") from error


def compare(
    scenario: Annotated[str, typer.Option(help="A built-in scenario, or a TOML file.")],
    *,
    seed: Annotated[int, typer.Option(min=0, help="Of the first pair; the next pair has the next seed.")] = 0,
    out: Annotated[Path, typer.Option(help="Folder for picture, numbers and simulations; made if missing.")] = Path(
        "comparison"
    ),
    as_json: Annotated[bool, typer.Option("--json", help="Print the numbers as JSON instead of a table.")] = False,
    parameter_errors: Annotated[
        bool, typer.Option("--parameter-errors", help="Let the simulated vehicles differ from the assumed one.")
    ] = False,
) -> None:
    """Simulate a fleet, ingest it, run the jobs and every estimator, and compare them with the truth."""
    from api.comparison import report, study
    from ingest.simulator.drawn_fleet import with_seed
    from ingest.simulator.scenario import VehicleErrors
    from ingest.simulator.scenario_file import load_scenario

    plan = load_scenario(scenario)
    if parameter_errors:
        plan = replace(plan, vehicle_errors=plan.vehicle_errors or VehicleErrors())
    _make_folder(out)
    with bar(Console(stderr=True)) as progress:
        step = progress.add_task("begin", total=1)

        def show(what: str, done: int, of: int) -> None:
            progress.update(step, description=what, completed=done, total=of)

        seeds = range(seed, seed + (1 if plan.drawn is None else len(plan.drawn.pairs)))
        studies = [study.study(with_seed(plan, number), out / "recordings", show) for number in seeds]
    numbers = report.as_json(studies, plan.name)
    text = orjson.dumps(numbers, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE).decode()
    (out / "comparison.json").write_text(text, encoding="utf-8")
    (out / "comparison.md").write_text(report.markdown(studies), encoding="utf-8")
    report.save_comparison(studies, out / "comparison.png")
    if as_json:
        typer.echo(text, nl=False)
        return
    console = Console()
    console.print(report.table(studies))
    for sentence in report.sentences_of(studies):
        console.print(sentence, highlight=False, soft_wrap=True)
    console.print(f"wrote comparison.png, comparison.md, comparison.json to {out}", highlight=False, soft_wrap=True)


def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for pictures and numbers; made if missing.")] = Path("reproduction"),
    seconds: Annotated[float, typer.Option(min=60.0, help="Length of each run, s of simulated time.")] = 600.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the track.")] = 1,
) -> None:
    """Run the paper's two simulations, estimate all four combinations, draw and write what came out."""
    from api import reproduction

    console = Console()
    _make_folder(out)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        step = progress.add_task("constant gauge: simulate, estimate", total=4)
        constant = reproduction.run(0.0, seconds, seed)
        progress.update(step, advance=1, description="gauge varying by 2 mm: simulate, estimate")
        varying = reproduction.run(reproduction.STANDARD_DEVIATION, seconds, seed)
        progress.update(step, advance=1, description="draw")
        pictures = {
            "figure_3.png": reproduction.figure_3(constant.table),
            "figure_4.png": reproduction.figure_4(varying),
            "figure_6.png": reproduction.figure_estimates(constant, "Fig. 6: estimation, no gauge variation"),
            "figure_7.png": reproduction.figure_estimates(varying, "Fig. 7: estimation, gauge varying by 2 mm (1 std)"),
        }
        for name, picture in pictures.items():
            picture.savefig(out / name, dpi=110)
        progress.update(step, advance=1, description="write numbers")
        values = reproduction.numbers(constant.table, {"figure_6": constant, "figure_7": varying}, seed)
        (out / "numbers.json").write_text(json.dumps(values, indent=1, allow_nan=False), encoding="utf-8")
        (out / "figure_6.md").write_text(reproduction.page("Figure 6, constant gauge", constant), encoding="utf-8")
        (out / "figure_7.md").write_text(reproduction.page("Figure 7, gauge varying", varying), encoding="utf-8")
        progress.update(step, advance=1, description="done")
    console.print(f"wrote {', '.join([*pictures, 'numbers.json', 'figure_6.md', 'figure_7.md'])} to {out}")


class OutputFormat(StrEnum):
    """How the result is written."""

    JSON = "json"
    CSV = "csv"
    PNG = "png"


_Wheel = Annotated[
    str,
    typer.Option(help=f"Wheel profile of both sides: a name (P8, S1002, EN15302-A ...) or a file: {format_names()}"),
]
_Rail = Annotated[str, typer.Option(help="Rail profile: a name (56E1, 60E1, 49E1, EN15302-A ...) or a file")]
_Inclination = Annotated[str, typer.Option(help="Rail inclination, as 1:20; 0 for a rail in track axes")]
_Gauge = Annotated[float, typer.Option(help="Track gauge, within 14 mm below the top of the rails")]
_Method = Annotated[ContactMethod, typer.Option(help="en15302: no roll; rigid: rolls until both wheels touch")]
_Format = Annotated[OutputFormat, typer.Option("--format", help="json, csv or png")]
_WheelLeft = Annotated[str | None, typer.Option(help="Left wheel, where it differs")]
_WheelRight = Annotated[str | None, typer.Option(help="Right wheel, where it differs")]
_RadiusLeft = Annotated[float, typer.Option(help="Left wheel radius at the tread datum")]
_RadiusRight = Annotated[float, typer.Option(help="Right wheel radius at the tread datum")]
_Mirror = Annotated[
    bool | None,
    typer.Option(
        "--mirror/--no-mirror",
        help="Of a rail file: its gauge side is at positive (negative) y; without, its shape shows it",
    ),
]
_Origin = Annotated[Origin, typer.Option(help="Of wheel files: what y = 0 is")]
_Noise = Annotated[
    float | None,
    typer.Option(help="Noise of the instrument of profile files (std); without, the points show it; 0: none"),
]
_FlangeBack = Annotated[float, typer.Option(help="Distance between the flange backs")]
_Speed = Annotated[float, typer.Option(help="Greatest speed of the vehicle, for the limit of the shipped rules")]
_Out = Annotated[Path | None, typer.Option(help="File to write; needed for png, else standard output")]


def contact(
    wheel: _Wheel = "P8",
    rail: _Rail = "56E1",
    inclination: _Inclination = "1:20",
    gauge_mm: _Gauge = 1435.0,
    method: _Method = ContactMethod.EN15302,
    output_format: _Format = OutputFormat.JSON,
    wheel_left: _WheelLeft = None,
    wheel_right: _WheelRight = None,
    radius_left_mm: _RadiusLeft = 460.0,
    radius_right_mm: _RadiusRight = 460.0,
    mirror: _Mirror = None,
    origin: _Origin = Origin.AUTO,
    noise_mm: _Noise = None,
    flange_back_mm: _FlangeBack = 1360.0,
    speed_km_h: _Speed = 120.0,
    out: _Out = None,
) -> None:
    """Print contact geometry and equivalent conicity of a wheelset on a track."""
    from api.terminal.contact import Dimensions, FileOptions, contact_of, notes, refusals, save_picture, table_text

    with refusals():
        wheels = wheel_left or wheel, wheel_right or wheel
        dimensions = Dimensions(inclination, gauge_mm, (radius_left_mm, radius_right_mm), flange_back_mm)
        asked = contact_of(wheels, rail, FileOptions(mirror, origin, noise_mm), dimensions, method, speed_km_h)
        for note in notes(asked):
            typer.echo(f"treadwatch contact: {note}", err=True)
        if output_format is OutputFormat.PNG:
            save_picture(asked, out)
            return
        text = table_text(asked, as_json=output_format is OutputFormat.JSON)
        if out is None:
            typer.echo(text, nl=False)
        else:
            out.write_text(text, encoding="utf-8")
