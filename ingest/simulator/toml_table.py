"""Strict reading of a TOML table: every key is asked for by name, type and range, and what is left over is an error."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar

from estimation.errors import ScenarioError
from ingest.simulator.sensors import FULL_RATE_HZ, Channel, SensorNode, ideal_node

Path_ = tuple[str | int, ...]
_HEADER = re.compile(r"^\s*(\[\[|\[)\s*([A-Za-z0-9_.\-]+)\s*\]")
_KEY = re.compile(r"^\s*([A-Za-z0-9_\-]+)\s*=")
_T = TypeVar("_T")


def key_lines(text: str) -> dict[Path_, int]:
    """Return the line (from 1) of every table header and bare key of a TOML text, by path."""
    lines: dict[Path_, int] = {}
    counts: dict[Path_, int] = {}
    here: Path_ = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            here = ()
            names = header[2].split(".")
            for place, name in enumerate(names):
                here = (*here, name)
                if header[1] == "[[" and place == len(names) - 1:
                    counts[here] = counts.get(here, -1) + 1
                if here in counts:
                    here = (*here, counts[here])
            lines.setdefault(here, number)
        elif key := _KEY.match(line):
            lines.setdefault((*here, key[1]), number)
    return lines


class TomlTable:
    """One table of a scenario file; call ``end`` when every known key has been taken.

    Raises
    ------
    ScenarioError
        From every method: a key is missing, unknown, of the wrong type, or out of range; names file, line and key.
    """

    def __init__(self, values: Mapping[str, Any], file: Path, lines: Mapping[Path_, int], place: Path_ = ()) -> None:
        self._values = values
        self._file = file
        self._lines = lines
        self._place = place
        self._taken: set[str] = set()

    def fail(self, reason: str, key: str | None = None) -> ScenarioError:
        """Return the error that names this table and ``key``."""
        place = self._place if key is None else (*self._place, key)
        return ScenarioError(
            reason, file=self._file, line=self._lines.get(place, self._lines.get(self._place)), field=dotted(place)
        )

    @property
    def folder(self) -> Path:
        """Folder of the file: relative file names start here."""
        return self._file.parent

    def has(self, key: str) -> bool:
        """Whether the key is given."""
        return key in self._values

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text that is not empty."""
        value = self._take(key, str, default)
        if not value.strip():
            raise self.fail("must not be empty", key)
        return value

    def integer(self, key: str, default: int | None = None, *, low: int = 0, high: int = 2**53) -> int:
        """Return a whole number within ``low..high``."""
        value = self._take(key, int, default)
        return int(self._within(key, value, low, high))

    def number(
        self, key: str, default: float | None = None, *, low: float = 0.0, high: float = math.inf, above: bool = False
    ) -> float:
        """Return a finite number within ``low..high``; with ``above`` greater than ``low``."""
        value = self._take(key, (int, float), default)
        if above and value == low:
            raise self.fail(f"{value} must be greater than {low:g}", key)
        return float(self._within(key, value, low, high))

    def flag(self, key: str, *, default: bool) -> bool:
        """Return true or false."""
        value = self._values.get(key, default)
        self._taken.add(key)
        if not isinstance(value, bool):
            raise self.fail(f"{value!r} is neither true nor false", key)
        return value

    def numbers(self, key: str, default: Sequence[float] | None = None, *, low: float = 0.0) -> tuple[float, ...]:
        """Return a list of finite numbers that strictly increases."""
        values = self._take(key, list, None if default is None else list(default))
        for value in values:
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise self.fail(f"{value!r} in the list is not a number", key)
            self._within(key, value, low, math.inf)
        if any(later <= earlier for earlier, later in pairwise(values)):
            raise self.fail("the list must increase", key)
        return tuple(float(value) for value in values)

    def moment_ns(self, key: str) -> int:
        """Return a date and time with its offset from UTC, as ns since 1970."""
        value = self._take(key, datetime, None)
        if value.tzinfo is None:
            raise self.fail("needs an offset from UTC, as in 2024-01-08T05:30:00Z", key)
        return round(value.timestamp()) * 1_000_000_000

    def table(self, key: str) -> TomlTable:
        """Return a table within; an empty one where it is not given."""
        value = self._values.get(key, {})
        self._taken.add(key)
        if not isinstance(value, dict):
            raise self.fail("must be a table", key)
        return TomlTable(value, self._file, self._lines, (*self._place, key))

    def optional_tables(self, key: str) -> list[TomlTable]:
        """Return the tables of an array of tables, none where the key is missing."""
        self._taken.add(key)
        return self.tables(key) if key in self._values else []

    def tables(self, key: str) -> list[TomlTable]:
        """Return the tables of an array of tables, at least one."""
        value = self._take(key, list, None)
        if not value or not all(isinstance(item, dict) for item in value):
            raise self.fail("must be one or more tables", key)
        return [
            TomlTable(item, self._file, self._lines, (*self._place, key, index)) for index, item in enumerate(value)
        ]

    def end(self) -> None:
        """Check that nothing is left over."""
        for key in self._values:
            if key not in self._taken:
                raise self.fail(f"unknown key; known here: {', '.join(sorted(self._taken))}", key)

    def _take(self, key: str, kind: type[_T] | tuple[type[_T], ...], default: _T | None) -> _T:
        self._taken.add(key)
        if key not in self._values:
            if default is None:
                raise self.fail("is missing", key)
            return default
        value = self._values[key]
        if not isinstance(value, kind) or isinstance(value, bool):
            kinds = kind if isinstance(kind, tuple) else (kind,)
            raise self.fail(f"{value!r} is not a {' or '.join(_SPOKEN[item] for item in kinds)}", key)
        return value

    def _within(self, key: str, value: float, low: float, high: float) -> float:
        if not math.isfinite(value):
            raise self.fail(f"{value} is not a finite number", key)
        if not low <= value <= high:
            raise self.fail(f"{value} is outside {low:g} to {high:g}", key)
        return value


_SPOKEN: Mapping[type, str] = {
    str: "text",
    int: "whole number",
    float: "number",
    list: "list",
    datetime: "date and time",
}


def dotted(place: Path_) -> str:
    """Return a path as in ``vehicles[1].wheelsets[0].serial``."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


MICRO_G = 9.80665e-6


def sensor_node(table: TomlTable) -> SensorNode:
    """Return the sensor node that a ``sensors`` table describes."""
    kind = table.text("kind", "mems")
    rate = table.integer("rate_hz", 250, low=1, high=FULL_RATE_HZ)
    if FULL_RATE_HZ % rate:
        raise table.fail(f"{rate} Hz does not divide {FULL_RATE_HZ} Hz", "rate_hz")
    if kind == "ideal":
        table.end()
        return ideal_node(rate)
    if kind != "mems":
        raise table.fail(f"{kind!r} is neither 'mems' nor 'ideal'", "kind")
    linear = Channel(
        noise_density=MICRO_G * table.number("lateral_noise_ug_per_root_hz", 100.0),
        offset=1e3 * MICRO_G * table.number("lateral_offset_mg", 20.0),
        drift=MICRO_G * table.number("lateral_drift_ug_per_root_s", 20.0),
        limit=1e6 * MICRO_G * table.number("lateral_limit_g", 50.0, above=True),
    )
    mass = Channel(
        noise_density=MICRO_G * table.number("mass_noise_ug_per_root_hz", 100.0),
        offset=1e3 * MICRO_G * table.number("mass_offset_mg", 10.0),
        drift=MICRO_G * table.number("mass_drift_ug_per_root_s", 20.0),
        limit=1e6 * MICRO_G * table.number("mass_limit_g", 2.0, above=True),
    )
    angular = Channel(
        noise_density=table.number("angular_noise_rad_s2_per_root_hz", 2e-3),
        offset=table.number("angular_offset_rad_s2", 0.05),
        drift=table.number("angular_drift_rad_s2_per_root_s", 2e-4),
        limit=table.number("angular_limit_rad_s2", 100.0, above=True),
    )
    filtered = table.flag("anti_alias", default=True)
    table.end()
    return SensorNode(linear, angular, angular, mass, rate_hz=rate, anti_alias=filtered)
