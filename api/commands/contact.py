"""``treadwatch contact``: contact geometry and equivalent conicity of a wheel and rail pair."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from estimation.contact.table import ContactMethod
from ingest.profiles.formats import format_names
from ingest.profiles.origin import Origin


class OutputFormat(StrEnum):
    """How the result is written."""

    JSON = "json"
    CSV = "csv"
    PNG = "png"


def contact(
    wheel: Annotated[
        str,
        typer.Option(
            help=f"Wheel profile of both sides: a name (P8, S1002, EN15302-A ...) or a file: {format_names()}"
        ),
    ] = "P8",
    rail: Annotated[
        str, typer.Option(help="Rail profile: a name (56E1, 60E1, 60E2, EN15302-A ...) or a file")
    ] = "56E1",
    inclination: Annotated[str, typer.Option(help="Rail inclination, as 1:20; 0 for a rail in track axes")] = "1:20",
    gauge_mm: Annotated[float, typer.Option(help="Track gauge, within 14 mm below the top of the rails")] = 1435.0,
    method: Annotated[ContactMethod, typer.Option(help="en15302: no roll; rigid: rolls until both wheels touch")] = (
        ContactMethod.EN15302
    ),
    output_format: Annotated[OutputFormat, typer.Option("--format", help="json, csv or png")] = OutputFormat.JSON,
    wheel_left: Annotated[str | None, typer.Option(help="Left wheel, where it differs")] = None,
    wheel_right: Annotated[str | None, typer.Option(help="Right wheel, where it differs")] = None,
    radius_left_mm: Annotated[float, typer.Option(help="Left wheel radius at the tread datum")] = 460.0,
    radius_right_mm: Annotated[float, typer.Option(help="Right wheel radius at the tread datum")] = 460.0,
    mirror: Annotated[
        bool | None,
        typer.Option(
            "--mirror/--no-mirror",
            help="Of a rail file: its gauge side is at positive (negative) y; without, its shape shows it",
        ),
    ] = None,
    origin: Annotated[Origin, typer.Option(help="Of wheel files: what y = 0 is")] = Origin.AUTO,
    noise_mm: Annotated[
        float | None,
        typer.Option(help="Noise of the instrument of profile files (std); without, the points show it; 0: none"),
    ] = None,
    flange_back_mm: Annotated[float, typer.Option(help="Distance between the flange backs")] = 1360.0,
    out: Annotated[Path | None, typer.Option(help="File to write; needed for png, else standard output")] = None,
) -> None:
    """Print contact geometry and equivalent conicity of a wheelset on a track."""
    from api.terminal.contact import (
        Contact,
        FileOptions,
        measured_shapes,
        notes,
        parse_inclination,
        refusals,
        save_picture,
        table_text,
    )
    from estimation.contact.geometry import WheelsetOnTrack

    with refusals():
        wheels = wheel_left or wheel, wheel_right or wheel
        shapes = measured_shapes(wheels, rail, FileOptions(mirror, origin, noise_mm))
        wheelset = WheelsetOnTrack(
            left_wheel=shapes.left_wheel.profile,
            right_wheel=shapes.right_wheel.profile,
            left_rail=shapes.left_rail.profile,
            right_rail=shapes.right_rail.profile,
            inclination=parse_inclination(inclination),
            gauge=gauge_mm * 1e-3,
            left_radius=radius_left_mm * 1e-3,
            right_radius=radius_right_mm * 1e-3,
            flange_back_distance=flange_back_mm * 1e-3,
        )
        asked = Contact(wheelset, shapes, method, inclination)
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
