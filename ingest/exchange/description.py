"""Schema of the TOML file of an exchange: what the columns of its table are."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from estimation.errors import ExchangeError, ParameterError
from estimation.values.reasons import EPOCH
from estimation.values.registry import MAX_AXLES, Kilometres
from ingest.file_value import FIRST_YEAR, LAST_YEAR
from ingest.input_file import InputFile, InputTable, Location, Text, field_error, read_toml, refusing
from ingest.units import SENSOR_QUANTITIES, Quantity, Unit, unit_of

MOTIONS = ("time", "position", "speed")
SIGNALS = ("lateral", "yaw", "roll", "mass_lateral")
"""Signals of an axle, in the order of the accelerations of a window."""

QUANTITIES: Mapping[str, tuple[Quantity, ...]] = {
    **SENSOR_QUANTITIES,
    "time": (Quantity.TIME,),
    "position": (Quantity.LENGTH,),
}


def _with_zone(moment: datetime) -> datetime:
    if moment.tzinfo is None:
        raise field_error("needs its offset from UTC, as in 2026-01-05T06:00:00Z")
    if not FIRST_YEAR <= moment.year <= LAST_YEAR:
        raise field_error(f"{moment.isoformat()} is outside the years {FIRST_YEAR} to {LAST_YEAR}")
    return moment


Character = Annotated[str, refusing(lambda text: len(text) != 1, "{value!r} is not one character")]


class Column(InputTable):
    """A column of the table and the unit of its numbers; ``turned`` where the sensor was mounted the other way."""

    column: Text
    unit: str
    turned: bool = False


class AxleTable(InputTable):
    """The columns of one axle: of its wheelset, and ``mass_lateral`` of the mass or frame above it."""

    axle: int = Field(ge=1, le=MAX_AXLES)
    lateral: Column
    yaw: Column
    roll: Column
    mass_lateral: Column


class AxesTable(InputTable):
    """Where the axes point. Rotations are positive by the right hand, or as ``yaw`` and ``roll`` give them."""

    x: Literal["forward", "backward"]
    y: Literal["left", "right"]
    z: Literal["up", "down"]
    yaw: Literal["front_left", "front_right"] | None = None
    roll: Literal["left_up", "left_down"] | None = None

    @model_validator(mode="after")
    def _check_hand(self) -> Self:
        turned = (self.x == "backward") + (self.y == "right") + (self.z == "down")
        if turned % 2 == 0 or (self.yaw is not None and self.roll is not None):
            return self
        other = "right" if self.y == "left" else "left"
        raise field_error(
            f"x {self.x}, y {self.y}, z {self.z} are left-handed axes: turn one of them (y {other}?),"
            " or give the positive sense of yaw and roll",
            "y",
        )

    @property
    def signs(self) -> Mapping[str, float]:
        """Sign of each signal towards x forward, y left, z up, yaw front left, roll left up (ISO 8855)."""
        lateral = 1.0 if self.y == "left" else -1.0
        yaw_left = (self.yaw or ("front_left" if self.z == "up" else "front_right")) == "front_left"
        left_up = (self.roll or ("left_up" if self.x == "forward" else "left_down")) == "left_up"
        return {
            "lateral": lateral,
            "yaw": 1.0 if yaw_left else -1.0,
            "roll": 1.0 if left_up else -1.0,
            "mass_lateral": lateral,
        }


class SamplingTable(InputTable):
    """How the table was sampled."""

    rate_hz: float = Field(ge=50.0, le=1e6)


class CsvTable(InputTable):
    """How a CSV file is written."""

    delimiter: Character = ","
    decimal: Literal[".", ","] = "."
    header_line: int = Field(default=1, ge=1)
    first_line: int | None = Field(default=None, ge=2)  # of the numbers; by default the one after the header

    @property
    def first(self) -> int:
        """Line of the first numbers, from 1."""
        return self.first_line or self.header_line + 1

    @model_validator(mode="after")
    def _check_lines(self) -> Self:
        if self.first <= self.header_line:
            raise field_error("must be after the header", "first_line")
        if self.decimal == self.delimiter:
            raise field_error("is the delimiter too", "decimal")
        return self


class RunTable(InputTable):
    """Which vehicle ran where, and when the time of the table is 0."""

    vehicle: Text
    section: Text
    start: Annotated[datetime, AfterValidator(_with_zone)]
    odometer_km: Kilometres  # where the table begins
    position_quality: float = Field(default=1.0, ge=0.0, le=1.0)
    position_of_axle: int | None = Field(default=None, ge=1, le=MAX_AXLES)  # by default the reference point's
    lateral_includes_gravity: bool

    @property
    def start_ns(self) -> int:
        """Time on the vehicle's clock at which the time of the table is 0, ns UTC."""
        since = self.start.astimezone(UTC) - EPOCH
        return (since.days * 86_400_000_000 + since.seconds * 1_000_000 + since.microseconds) * 1000


class ExchangeFile(InputTable):
    """The whole TOML file."""

    data: Text
    run: RunTable
    axes: AxesTable
    sampling: SamplingTable
    csv: CsvTable = CsvTable()
    time: Column
    position: Column
    speed: Column
    axles: list[AxleTable] = Field(min_length=1, max_length=MAX_AXLES)

    @model_validator(mode="after")
    def _check_columns(self) -> Self:
        for index, (location, column) in enumerate(self.columns):
            try:
                unit_of(column.unit, QUANTITIES[str(location[-1])])
            except ParameterError as error:
                raise field_error(error.reason, *location, "unit") from error
            if column.turned and location[-1] in MOTIONS:
                raise field_error("only a sensor of an axle can be turned", *location, "turned")
            others = [name for name, other in self.columns[:index] if other.column == column.column]
            if others:
                other = ".".join(map(str, others[0]))
                raise field_error(f"column {column.column!r} is that of {other} too", *location, "column")
        numbers = [axle.axle for axle in self.axles]
        for index, number in enumerate(numbers):
            if number in numbers[:index]:
                raise field_error(f"axle {number} is there twice", "axles", index, "axle")
        return self

    @property
    def columns(self) -> list[tuple[Location, Column]]:
        """All columns and where in the file they are described."""
        columns: list[tuple[Location, Column]] = [((name,), getattr(self, name)) for name in MOTIONS]
        for index, axle in enumerate(self.axles):
            columns += [(("axles", index, name), getattr(axle, name)) for name in SIGNALS]
        return columns


def unit(name: str, column: Column) -> Unit:
    """Return the unit of a column."""
    return unit_of(column.unit, QUANTITIES[name])


def read_description(path: Path) -> tuple[ExchangeFile, InputFile]:
    """Return the content of the TOML file, and where in the file each key stands."""
    file = read_toml(path, ExchangeError)
    return file.parse(ExchangeFile), file
