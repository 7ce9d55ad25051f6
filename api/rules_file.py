"""Read rules from a TOML file; everything that is not written there keeps its shipped default.

::

    [conicity_limit]
    raise_probability = 0.9
    delays = { on_evaluations = 2 }

    [[conicity_limit.bands]]
    vehicle_class = "freight"
    up_to_km_h = 120
    limit = 0.45
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, TypeVar

from estimation.alerts.rules.book import RuleBook, SpeedBand
from estimation.errors import InputError

_Rule = TypeVar("_Rule")

# least and greatest of every number that is not simply "finite and not negative"
_PROBABILITY = (0.5, 0.9999)
_SHARE = (0.0, 1.0)
_RANGES: Mapping[str, tuple[float, float]] = {
    "raise_probability": _PROBABILITY,
    "clear_probability": _PROBABILITY,
    "raise_share": _SHARE,
    "clear_share": _SHARE,
    "clipped_share": _SHARE,
    "invalid_share": _SHARE,
    "per_km_h": (-1.0, 1.0),
    "up_to_km_h": (1.0, math.inf),
    "limit": (0.001, 2.0),
    "on_evaluations": (1, 1000),
    "off_evaluations": (1, 1000),
    "minimum_windows": (1, 1_000_000),
    "minimum_points": (2, 1_000_000),
    "latest_windows": (1, 1000),
    "more_than": (1, 1_000_000),
    "within_hours": (0.01, 87_600.0),
    "days": (0.01, 3650.0),
    "acknowledgement_days": (0.01, 3650.0),
}
# (raise, clear, whether clear lies below)
_APART = (
    ("limit_forecast", "within_km", "clear_within_km", False),
    ("wheel_asymmetry", "offset_limit_mm", "offset_clear_mm", True),
    ("wheel_asymmetry", "shape_limit_mm", "shape_clear_mm", True),
    ("no_data", "days", "critical_days", False),
    ("sensor_fault", "raise_share", "clear_share", True),
)


def load_rules(path: Path) -> RuleBook:
    """Return the rule book of a TOML file.

    Raises
    ------
    InputError
        The file cannot be read or is no TOML; an unknown table or key; a value of the wrong type or outside its range;
        a clear limit on the wrong side of its raise limit. Names the file and the field.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"the rules cannot be read: {error}", file=path) from error
    try:
        tables = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"this is no TOML: {error}", file=path) from error
    book = RuleBook()
    known = {f.name: getattr(book, f.name) for f in fields(book)}
    rules = {}
    for name, table in tables.items():
        if name not in known:
            raise InputError(f"unknown rule; there are {', '.join(known)}", file=path, field=name)
        rules[name] = _filled(known[name], table, path, name)
    book = replace(book, **rules)
    _check_apart(book, path)
    return book


def _filled(default: _Rule, table: object, path: Path, place: str) -> _Rule:
    if not isinstance(table, dict):
        raise InputError("must be a table", file=path, field=place)
    values: dict[str, Any] = {}
    known = {f.name for f in fields(default)}  # type: ignore[arg-type]
    for key, value in table.items():
        where = f"{place}.{key}"
        if key not in known:
            raise InputError(f"unknown key; there are {', '.join(sorted(known))}", file=path, field=where)
        if key == "bands":
            values[key] = _bands(value, path, where)
        elif key in ("delays", "parameters"):
            values[key] = _filled(getattr(default, key), value, path, where)
        else:
            values[key] = _checked(getattr(default, key), key, value, path, where)
    return replace(default, **values)  # type: ignore[type-var]


def _bands(value: object, path: Path, place: str) -> tuple[SpeedBand, ...]:
    if not isinstance(value, list) or not value:
        raise InputError("must be a list of at least one band", file=path, field=place)
    bands = []
    for i, table in enumerate(value):
        where = f"{place}[{i}]"
        if isinstance(table, dict) and "limit" not in table:
            raise InputError("a band needs a limit", file=path, field=f"{where}.limit")
        bands.append(_filled(SpeedBand(math.inf, 0.4), table, path, where))
    return tuple(bands)


def _checked(default: object, key: str, value: object, path: Path, place: str) -> object:
    if isinstance(default, (bool, str)):
        if not isinstance(value, type(default)):
            raise InputError(f"must be a {type(default).__name__}", file=path, field=place)
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError("must be a number", file=path, field=place)
    if isinstance(default, int) and value != int(value if math.isfinite(value) else 0):
        raise InputError("must be a whole number", file=path, field=place)
    least, greatest = _RANGES.get(key, (0.0, 1e9))
    if not least <= value <= greatest:
        raise InputError(f"{value} is outside {least:g} to {greatest:g}", file=path, field=place)
    return int(value) if isinstance(default, int) else float(value)


def _check_apart(book: RuleBook, path: Path) -> None:
    for rule, raised, cleared, below in _APART:
        first, second = getattr(getattr(book, rule), raised), getattr(getattr(book, rule), cleared)
        if (second > first) if below else (second < first):
            side = "above" if below else "below"
            raise InputError(f"{second:g} lies {side} {raised} ({first:g})", file=path, field=f"{rule}.{cleared}")
