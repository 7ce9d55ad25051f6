"""Contact geometry and equivalent conicity of a wheel and rail pair, as a table in JSON or CSV, or as a picture."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import orjson
import typer
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from estimation.alerts.rules.conicity_limit import ANY_CLASS, ConicityLimitRule
from estimation.contact.conicity import MeasuredShapes, conicity_std, equivalent_conicity, nonlinearity_parameter
from estimation.contact.geometry import (
    ContactTable,
    RadiusDifferenceCurve,
    WheelsetOnTrack,
    contact_table,
    radius_difference_curve,
)
from estimation.contact.method import ContactMethod
from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import ProfileKind, is_design, rail_profile, wheel_profile
from estimation.contact.smoothed_profile import SmoothedProfile, exact
from estimation.errors import InputError, ParameterError
from estimation.trend.extrapolation import LIMIT_AMPLITUDE
from estimation.values.arrays import FloatArray
from estimation.values.units import MILLIMETRE
from ingest.profiles.files import read_measured_profile
from ingest.profiles.orientation import LEAST_LEAN, lean
from ingest.profiles.points import Origin

AMPLITUDE_MM = LIMIT_AMPLITUDE * 1e3


@dataclass(frozen=True, slots=True)
class ContactSummary:
    """Wheel, rail, gauge, and the equivalent conicity at 3 mm beside the limit of the shipped rules, as columns."""

    wheel_left: str
    wheel_right: str
    rail: str
    inclination: str  # of the rails, as it was written
    gauge_mm: float
    method: str
    equivalent_conicity_at_3_mm_1: float | None  # None where the contact gives none
    equivalent_conicity_at_3_mm_std_1: float | None
    limit_1: float | None  # None where there is none
    limit_speed_km_h: float

    @property
    def title(self) -> str:
        """Return it in one line."""
        wheels = self.wheel_left if self.wheel_left == self.wheel_right else f"{self.wheel_left} / {self.wheel_right}"
        return f"{wheels} on {self.rail} {self.inclination}, gauge {self.gauge_mm:g} mm, {self.method}"

    @property
    def verdict(self) -> str:
        """Return the conicity at 3 mm beside the limit."""
        value = "unknown" if self.equivalent_conicity_at_3_mm_1 is None else f"{self.equivalent_conicity_at_3_mm_1:.3f}"
        if self.limit_1 is None:
            return f"at 3 mm: {value}; no limit at {self.limit_speed_km_h:g} km/h"
        return f"at 3 mm: {value}; limit {self.limit_1:.3f} at {self.limit_speed_km_h:g} km/h"


INTERVAL = 1.96  # standard deviations
_LEFT, _RIGHT, _BOTH, _LIMIT = "#1f5fa8", "#c4561a", "#222222", "#b00020"


def save_contact_figure(
    table: ContactTable,
    amplitude: FloatArray,
    conicity: FloatArray,
    std: FloatArray,
    summary: ContactSummary,
    out: Path,
) -> None:
    """Write radii, contact angles and positions, and conicity (k,) with its std, of the table's first gauge as PNG."""
    figure = Figure(figsize=(10.0, 7.5), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    y = table.lateral_displacement * 1e3
    _curves(axes[0, 0], y, [("left - right", table.rolling_radius_difference[:, 0] * 1e3, _BOTH)])
    axes[0, 0].set_ylabel("rolling radius difference, mm")
    sides = (("left", _LEFT), ("right", _RIGHT))
    angles = [(name, np.degrees(getattr(table, f"contact_angle_{name}")[:, 0]), colour) for name, colour in sides]
    _curves(axes[0, 1], y, angles)
    axes[0, 1].set_ylabel("contact angle, degrees")
    places = [(name, getattr(table, f"contact_position_{name}")[:, 0] * 1e3, colour) for name, colour in sides]
    _curves(axes[1, 0], y, places)
    axes[1, 0].set_ylabel("contact on the wheel from its tread datum, mm")
    for panel in (axes[0, 0], axes[0, 1], axes[1, 0]):
        panel.set_xlabel("lateral displacement (left positive), mm")
        panel.legend(frameon=False)
    axes[1, 1].plot(amplitude * 1e3, conicity, color=_BOTH, marker="o", markersize=3)
    if np.nan_to_num(std).any():
        low, high = conicity - INTERVAL * std, conicity + INTERVAL * std
        label = "95 % interval"
        axes[1, 1].fill_between(amplitude * 1e3, low, high, color=_BOTH, alpha=0.2, linewidth=0.0, label=label)
    if summary.limit_1 is not None:
        label = f"limit {summary.limit_1:.3f} at {summary.limit_speed_km_h:g} km/h"
        axes[1, 1].axhline(summary.limit_1, color=_LIMIT, linestyle="--", linewidth=1.2, label=label)
    if summary.equivalent_conicity_at_3_mm_1 is not None:
        label = f"{summary.equivalent_conicity_at_3_mm_1:.3f} at 3 mm"
        axes[1, 1].plot(
            [AMPLITUDE_MM], [summary.equivalent_conicity_at_3_mm_1], "o", color=_RIGHT, markersize=7, label=label
        )
    axes[1, 1].legend(frameon=False)
    axes[1, 1].set_xlabel("amplitude, mm")
    axes[1, 1].set_ylabel("equivalent conicity tan γₑ")
    axes[1, 1].set_ylim(bottom=0.0)
    axes[1, 1].grid(visible=True, color="#dddddd")
    figure.suptitle(f"{summary.title}\nequivalent conicity {summary.verdict}")
    figure.savefig(out, format="png", dpi=110)


def _curves(panel: Axes, y: FloatArray, curves: list[tuple[str, FloatArray, str]]) -> None:
    for name, values, colour in curves:
        panel.plot(y, values, label=name, color=colour, linewidth=1.4)
    panel.grid(visible=True, color="#dddddd")
    panel.margins(x=0.0)


LEAST_PLAY_MM = 2.5  # a flange of 32.5 mm, the thickest of EN 13715, leaves 5 mm at 1435 and 1360 mm
LEAST_TURN = 2e-3  # rad, of a wheel against its design
FACE_DEPTH = 0.010  # m below the tread, where the thickness of a flange is measured
_DISPLACEMENT_MM = np.linspace(-8.0, 8.0, 161)
_AMPLITUDE_MM = np.linspace(0.5, 7.0, 66)


@dataclass(frozen=True, slots=True)
class FileOptions:
    """How profile files are read."""

    mirror: bool | None = None  # gauge side of a rail at positive y of the file; None: as its shape shows
    origin: Origin = Origin.AUTO  # what y = 0 of a wheel file is
    noise_mm: float | None = None  # of the instrument; None: as the points show


@dataclass(frozen=True, slots=True)
class Dimensions:
    """Of a wheelset and its track, as they are given."""

    inclination: str  # of the rails, as 1:20
    gauge_mm: float
    radii_mm: tuple[float, float]  # left and right, at the tread datum
    flange_back_mm: float  # from one to the other


@dataclass(frozen=True, slots=True)
class Contact:
    """A wheelset on a track, how well its profiles are known, and how contact points are found."""

    wheelset: WheelsetOnTrack
    shapes: MeasuredShapes
    method: ContactMethod
    inclination: str  # as it was written
    speed_km_h: float  # greatest speed of the vehicle, for the limit


def contact_of(
    wheels: tuple[str, str],
    rail: str,
    options: FileOptions,
    dimensions: Dimensions,
    method: ContactMethod,
    speed_km_h: float = 120.0,
) -> Contact:
    """Return a wheelset on a track from the names or files of its profiles."""
    shapes = measured_shapes(wheels, rail, options)
    wheelset = WheelsetOnTrack(
        left_wheel=shapes.left_wheel.profile,
        right_wheel=shapes.right_wheel.profile,
        left_rail=shapes.left_rail.profile,
        right_rail=shapes.right_rail.profile,
        inclination=parse_inclination(dimensions.inclination),
        gauge=dimensions.gauge_mm * MILLIMETRE,
        left_radius=dimensions.radii_mm[0] * MILLIMETRE,
        right_radius=dimensions.radii_mm[1] * MILLIMETRE,
        flange_back_distance=dimensions.flange_back_mm * MILLIMETRE,
    )
    return Contact(wheelset, shapes, method, dimensions.inclination, speed_km_h)


def measured_shapes(wheels: tuple[str, str], rail: str, options: FileOptions) -> MeasuredShapes:
    """Return the profiles of both wheels and of the rail, by the names of built-in ones or the paths of files."""
    for given, names, option in (
        (options.mirror is not None, (rail,), "--mirror"),
        (options.origin is not Origin.AUTO, wheels, "--origin"),
        (options.noise_mm is not None, (*wheels, rail), "--noise-mm"),
    ):
        if given and not any(_is_file(name) for name in names):
            raise ParameterError("is for profile files, and none is given", field=option)
    left = _shape(wheels[0], "wheel", options)
    right = left if wheels[1] == wheels[0] else _shape(wheels[1], "wheel", options)
    both = _shape(rail, "rail", options)
    return MeasuredShapes(left, right, both, both)


def _is_file(name: str) -> bool:
    path = Path(name)
    return not is_design(name) and bool(path.suffix) and (path.exists() or path.parent != Path())


def _shape(name: str, kind: ProfileKind, options: FileOptions) -> SmoothedProfile:
    if not _is_file(name):
        return exact(wheel_profile(name) if kind == "wheel" else rail_profile(name))
    noise = None if options.noise_mm is None else options.noise_mm * 1e-3
    if kind == "wheel":
        return read_measured_profile(name, "wheel", origin=options.origin, noise_std=noise)
    return read_measured_profile(name, "rail", mirror=options.mirror, noise_std=noise)


def notes(contact: Contact) -> list[str]:
    """Return what a user should know: points left out, flanges without play, a rail that is inclined twice."""
    shapes = {id(shape): shape for shape in (contact.shapes.left_wheel, contact.shapes.right_wheel)}
    said = [
        f"{shape.profile.name}: {len(shape.outliers)} points far from the profile are left out"
        for shape in (*shapes.values(), contact.shapes.left_rail)
        if shape.outliers
    ]
    said += [
        f"{shape.profile.name}: is {shape.design.name}, turned by {math.degrees(shape.design.turn):+.2f} degrees "
        "in its file: an error of the measurement? The conicity is that of the file"
        for shape in shapes.values()
        if shape.design is not None and abs(shape.design.turn) >= LEAST_TURN
    ]
    play = _play(contact.wheelset) / MILLIMETRE
    if play < LEAST_PLAY_MM:
        said.append(
            f"the flanges leave {play:.1f} mm of play to either side; is --flange-back-mm that of this vehicle, and "
            "--gauge-mm that of this track?"
        )
    rail = contact.wheelset.left_rail
    leaning = lean(rail.y * 1e3, rail.z * 1e3)
    if abs(leaning) >= LEAST_LEAN and contact.wheelset.inclination != 0.0:
        said.append(
            f"{rail.name}: leans by 1:{1.0 / leaning:.0f} in its file and is inclined {contact.inclination} besides; "
            "give --inclination 0 for a rail in track axes"
        )
    return said


def _play(wheelset: WheelsetOnTrack) -> float:
    """Return how far a wheelset moves from the middle until its flange, 10 mm below the tread, is at the gauge face, m.

    NaN if a flange does not reach so deep.
    """
    faces = []
    for wheel in (wheelset.left_wheel, wheelset.right_wheel):
        deep = np.flatnonzero(wheel.z >= FACE_DEPTH)
        faces.append(float(wheel.y[deep[-1]]) if len(deep) else float("nan"))
    return 0.5 * (wheelset.gauge - wheelset.flange_back_distance - 2.0 * PROFILES.tread_datum - sum(faces))


def parse_inclination(text: str) -> float:
    """Return the rail inclination, as a tangent, that is written as ``1:20``, ``1/20`` or ``0.05``."""
    rise, _, run = text.replace("/", ":").partition(":")
    try:
        return float(rise) / float(run) if run else float(rise)
    except (ValueError, ZeroDivisionError):
        raise ParameterError(f"{text!r} is no inclination; give it as 1:20, or 0", field="--inclination") from None


def save_picture(contact: Contact, out: Path | None) -> None:
    """Write the contact geometry of a wheelset as PNG."""
    if out is None:
        raise ParameterError("a picture needs --out FILE.png", field="--format")
    computed = _computed(contact)
    save_contact_figure(computed.table, _AMPLITUDE_MM * 1e-3, computed.conicity, computed.std, computed.summary, out)


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


class _Computed(NamedTuple):
    table: ContactTable
    curve: RadiusDifferenceCurve
    conicity: FloatArray  # at ``_AMPLITUDE_MM``
    std: FloatArray
    summary: ContactSummary


def _computed(contact: Contact) -> _Computed:
    wheelset, method, x, amplitude = contact.wheelset, contact.method, _DISPLACEMENT_MM * 1e-3, _AMPLITUDE_MM * 1e-3
    table = contact_table(wheelset, x, method=method, outside="hold")
    curve = radius_difference_curve(wheelset, x, method=method)
    conicity = equivalent_conicity(curve.displacement, curve.difference, amplitude)
    std = conicity_std(wheelset, contact.shapes, x, amplitude, method=method)
    place = int(np.argmin(np.abs(_AMPLITUDE_MM - AMPLITUDE_MM)))
    value, spread = _rounded(np.array([conicity[place], std[place]]))
    summary = ContactSummary(
        wheel_left=wheelset.left_wheel.name,
        wheel_right=wheelset.right_wheel.name,
        rail=wheelset.left_rail.name,
        inclination=contact.inclination,
        gauge_mm=round(wheelset.gauge * 1e3, 6),
        method=method.value,
        equivalent_conicity_at_3_mm_1=value,
        equivalent_conicity_at_3_mm_std_1=spread,
        limit_1=ConicityLimitRule().limit_at(ANY_CLASS, contact.speed_km_h),
        limit_speed_km_h=contact.speed_km_h,
    )
    return _Computed(table, curve, conicity, std, summary)


def _columns(table: ContactTable) -> dict[str, FloatArray]:
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


def table_text(contact: Contact, *, as_json: bool) -> str:
    """Return the contact geometry of a wheelset as JSON, or as CSV with the conicity at 3 mm alone."""
    computed = _computed(contact)
    summary = asdict(computed.summary)
    columns = {name: _rounded(values) for name, values in _columns(computed.table).items()}
    if not as_json:
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow((*columns, *summary))
        writer.writerows((*row, *summary.values()) for row in zip(*columns.values(), strict=True))
        return text.getvalue()
    curve = computed.curve
    document = {
        **summary,
        **columns,
        "equivalent_conicity": {
            "amplitude_mm": _rounded(_AMPLITUDE_MM),
            "value": _rounded(computed.conicity),
            "std": _rounded(computed.std),
        },
        "nonlinearity_parameter": _rounded(np.array([nonlinearity_parameter(curve.displacement, curve.difference)]))[0],
        "contact_jumps_mm": _rounded(curve.jumps * 1e3),
        "profiles": {
            "left_wheel": _described(contact.shapes.left_wheel),
            "right_wheel": _described(contact.shapes.right_wheel),
            "rails": _described(contact.shapes.left_rail),
        },
    }
    return orjson.dumps(document, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE).decode()


def _described(shape: SmoothedProfile) -> dict[str, object]:
    return {
        "name": shape.profile.name,
        "noise_mm": round(shape.noise_std * 1e3, 6),
        "points_left_out": len(shape.outliers),
        "design": None if shape.design is None else shape.design.name,
    }


def _rounded(values: FloatArray) -> list[float | None]:
    """Return numbers to a tenth of a nanometre or nanoradian, None for NaN."""
    return [round(float(value), 10) + 0.0 if np.isfinite(value) else None for value in values]
