"""``treadwatch contact``: contact geometry and equivalent conicity of a wheel and rail pair."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from estimation.contact.geometry import ContactMethod
from ingest.profiles.formats import format_names
from ingest.profiles.points import Origin


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
