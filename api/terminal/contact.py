"""Contact geometry and equivalent conicity of a wheel and rail pair, as a table in JSON or CSV, or as a picture."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import orjson
import typer

from api.plots.contact import save_contact_figure
from estimation.contact.conicity import equivalent_conicity, nonlinearity_parameter
from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import Profile, ProfileKind, rail_profile, wheel_profile
from estimation.contact.radius_difference import RadiusDifferenceCurve, radius_difference_curve
from estimation.contact.table import ContactMethod, ContactTable
from estimation.errors import InputError, ParameterError
from estimation.values.arrays import FloatArray
from ingest.profiles.files import read_profile

_DISPLACEMENT_MM = np.linspace(-8.0, 8.0, 161)
_AMPLITUDE_MM = np.linspace(0.5, 7.0, 66)


def read_named_profile(name: str, kind: ProfileKind) -> Profile:
    """Return a built-in profile, or the profile in a file.

    Parameters
    ----------
    name
        Name of a built-in profile, or path of a profile file: with a suffix, and there or in a folder.
    kind
        Whether it is a wheel or a rail.

    Raises
    ------
    ProfileError
        No such profile, or the file holds none.
    """
    path = Path(name)
    if path.suffix and (path.exists() or path.parent != Path()):
        return read_profile(path, kind)
    return wheel_profile(name) if kind == "wheel" else rail_profile(name)


def parse_inclination(text: str) -> float:
    """Return the rail inclination, as a tangent, that is written as ``1:20``, ``1/20`` or ``0.05``.

    Raises
    ------
    ParameterError
        ``text`` is none of these.
    """
    rise, _, run = text.replace("/", ":").partition(":")
    try:
        return float(rise) / float(run) if run else float(rise)
    except (ValueError, ZeroDivisionError):
        raise ParameterError(f"{text!r} is no inclination; give it as 1:20, or 0", field="--inclination") from None


def save_picture(wheelset: WheelsetOnTrack, method: ContactMethod, inclination: str, out: Path | None) -> None:
    """Write the contact geometry of a wheelset as PNG.

    Parameters
    ----------
    wheelset
        Profiles, radii and gauge.
    method
        How contact points are found.
    inclination
        Of the rails, as it was written; for the title.
    out
        File to write.

    Raises
    ------
    ParameterError
        No file is given.
    """
    if out is None:
        raise ParameterError("a picture needs --out FILE.png", field="--format")
    table, curve = _table(wheelset, method), _curve(wheelset, method)
    profiles = f"{wheelset.left_wheel.name} on {wheelset.left_rail.name} {inclination}"
    title = f"{profiles}, {wheelset.gauge * 1e3:g} mm, {method.value}"
    save_contact_figure(table, _AMPLITUDE_MM * 1e-3, _conicity(curve), title, out)


@contextmanager
def refusals() -> Iterator[None]:
    """Turn wrong input, and files that cannot be read or written, into one line and exit code 2."""
    try:
        yield
    except InputError as error:
        typer.echo(f"treadwatch contact: {error}", err=True)
        raise typer.Exit(2) from error
    except OSError as error:
        typer.echo(f"treadwatch contact: {error.filename}: {error.strerror}", err=True)
        raise typer.Exit(2) from error


def table_text(wheelset: WheelsetOnTrack, method: ContactMethod, *, as_json: bool) -> str:
    """Return the contact geometry of ``wheelset``, found by ``method``, as JSON, or as CSV without conicity.

    Parameters
    ----------
    wheelset
        Profiles, radii and gauge.
    method
        How contact points are found.
    as_json
        JSON with conicity, or else CSV without.
    """
    table = _table(wheelset, method)
    return _json(table, _curve(wheelset, method)) if as_json else _csv(table)


def _table(wheelset: WheelsetOnTrack, method: ContactMethod) -> ContactTable:
    return contact_table(wheelset, _DISPLACEMENT_MM * 1e-3, method=method, outside="hold")


def _curve(wheelset: WheelsetOnTrack, method: ContactMethod) -> RadiusDifferenceCurve:
    return radius_difference_curve(wheelset, _DISPLACEMENT_MM * 1e-3, method=method)


def _conicity(curve: RadiusDifferenceCurve) -> FloatArray:
    return equivalent_conicity(curve.displacement, curve.difference, _AMPLITUDE_MM * 1e-3)


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


def _json(table: ContactTable, curve: RadiusDifferenceCurve) -> str:
    nonlinearity = nonlinearity_parameter(curve.displacement, curve.difference)
    document = {
        **{name: _rounded(values) for name, values in _columns(table).items()},
        "equivalent_conicity": {"amplitude_mm": _rounded(_AMPLITUDE_MM), "value": _rounded(_conicity(curve))},
        "nonlinearity_parameter": _rounded(np.array([nonlinearity]))[0],
        "contact_jumps_mm": _rounded(curve.jumps * 1e3),
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
