"""``treadwatch contact``: contact geometry and equivalent conicity of a wheel and rail pair."""

from __future__ import annotations

import csv
import io
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import numpy as np
import orjson
import typer

from api.plots.contact import save_contact_figure
from estimation.contact.conicity import equivalent_conicity, nonlinearity_parameter
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import Profile, ProfileKind, rail_profile, wheel_profile
from estimation.contact.table import ContactMethod, ContactTable
from estimation.errors import InputError, ParameterError
from estimation.values.arrays import FloatArray
from ingest.profiles import read_profile

_DISPLACEMENT_MM = np.linspace(-8.0, 8.0, 161)
_AMPLITUDE_MM = np.linspace(0.5, 7.0, 66)


class OutputFormat(StrEnum):
    """How the result is written."""

    JSON = "json"
    CSV = "csv"
    PNG = "png"


def contact(
    wheel: Annotated[
        str, typer.Option(help="Wheel profile of both sides: a name (P8, S1002, EN15302-A ...) or a file")
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
    flange_back_mm: Annotated[float, typer.Option(help="Distance between the flange backs")] = 1360.0,
    out: Annotated[Path | None, typer.Option(help="File to write; needed for png, else standard output")] = None,
) -> None:
    """Print contact geometry and equivalent conicity of a wheelset on a track."""
    try:
        wheelset = WheelsetOnTrack(
            left_wheel=_profile(wheel_left or wheel, "wheel"),
            right_wheel=_profile(wheel_right or wheel, "wheel"),
            left_rail=_profile(rail, "rail"),
            right_rail=_profile(rail, "rail"),
            inclination=_inclination(inclination),
            gauge=gauge_mm * 1e-3,
            left_radius=radius_left_mm * 1e-3,
            right_radius=radius_right_mm * 1e-3,
            flange_back_distance=flange_back_mm * 1e-3,
        )
        table = contact_table(wheelset, _DISPLACEMENT_MM * 1e-3, method=method, outside="hold")
        title = (
            f"{wheelset.left_wheel.name} on {wheelset.left_rail.name} {inclination}, {gauge_mm:g} mm, {method.value}"
        )
        _write(table, output_format, title, out)
    except InputError as error:
        typer.echo(f"treadwatch contact: {error}", err=True)
        raise typer.Exit(2) from error
    except OSError as error:
        typer.echo(f"treadwatch contact: {error.filename}: {error.strerror}", err=True)
        raise typer.Exit(2) from error


def _profile(name: str, kind: ProfileKind) -> Profile:
    path = Path(name)
    if path.suffix and (path.exists() or path.parent != Path()):
        return read_profile(path, kind)
    return wheel_profile(name) if kind == "wheel" else rail_profile(name)


def _inclination(text: str) -> float:
    """Return the tangent that 1:20, 1/20 or 0.05 says."""
    rise, _, run = text.replace("/", ":").partition(":")
    try:
        return float(rise) / float(run) if run else float(rise)
    except (ValueError, ZeroDivisionError):
        raise ParameterError(f"{text!r} is no inclination; give it as 1:20, or 0", field="--inclination") from None


def _write(table: ContactTable, output_format: OutputFormat, title: str, out: Path | None) -> None:
    conicity = equivalent_conicity(table.lateral_displacement, _difference(table), _AMPLITUDE_MM * 1e-3)
    if output_format is OutputFormat.PNG:
        if out is None:
            raise ParameterError("a picture needs --out FILE.png", field="--format")
        save_contact_figure(table, _AMPLITUDE_MM * 1e-3, conicity, title, out)
        return
    text = _json(table, conicity) if output_format is OutputFormat.JSON else _csv(table)
    if out is None:
        typer.echo(text, nl=False)
    else:
        out.write_text(text, encoding="utf-8")


def _difference(table: ContactTable) -> FloatArray:
    """Return the rolling radius difference at the first gauge, NaN where both wheels have no contact."""
    return np.where(table.exists[:, 0], table.rolling_radius_difference[:, 0], np.nan)


def _columns(table: ContactTable) -> dict[str, FloatArray]:
    """Return the columns of the first gauge; NaN where both wheels have no contact."""
    exists = table.exists[:, 0]
    columns = {
        "rolling_radius_difference_mm": table.rolling_radius_difference[:, 0] * 1e3,
        "rolling_radius_sum_mm": table.rolling_radius_sum[:, 0] * 1e3,
        "contact_angle_difference_rad": table.contact_angle_difference[:, 0],
        "contact_angle_sum_rad": table.contact_angle_sum[:, 0],
        "roll_rad": table.roll[:, 0],
    }
    marked = {name: np.where(exists, values, np.nan) for name, values in columns.items()}
    return {"lateral_displacement_mm": table.lateral_displacement * 1e3, **marked}


def _json(table: ContactTable, conicity: FloatArray) -> str:
    nonlinearity = nonlinearity_parameter(table.lateral_displacement, _difference(table))
    document = {
        **{name: _rounded(values) for name, values in _columns(table).items()},
        "equivalent_conicity": {"amplitude_mm": _rounded(_AMPLITUDE_MM), "value": _rounded(conicity)},
        "nonlinearity_parameter": _rounded(np.array([nonlinearity]))[0],
    }
    return orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE).decode()


def _csv(table: ContactTable) -> str:
    columns = {name: _rounded(values) for name, values in _columns(table).items()}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()


def _rounded(values: FloatArray) -> list[float | None]:
    """Return numbers to a tenth of a nanometre or nanoradian, None for NaN."""
    return [round(float(value), 10) + 0.0 if np.isfinite(value) else None for value in values]
