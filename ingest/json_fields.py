"""Strict reading of JSON objects from outside: every field is asked for by name and type, what is left is an error."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from estimation.errors import InputError


def read_json(path: Path) -> Fields:
    """Return the object in a JSON file.

    Raises
    ------
    InputError
        The file cannot be read, is no JSON, or holds something else than an object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=path) from error
    except UnicodeDecodeError as error:
        raise InputError("is no text file", file=path) from error
    except json.JSONDecodeError as error:
        raise InputError(f"is no JSON: {error.msg}", file=path, line=error.lineno) from error
    if not isinstance(content, dict):
        raise InputError("must hold one object", file=path)
    return Fields(content, path)


class Fields:
    """The fields of one object; every method raises ``InputError`` naming file and field, ``end`` for what is left."""

    def __init__(self, values: Mapping[str, Any], file: Path, place: str = "") -> None:
        self._values = values
        self._file = file
        self._place = place
        self._taken: set[str] = set()

    def fail(self, reason: str, key: str) -> InputError:
        """Return the error about the field ``key``."""
        return InputError(reason, file=self._file, field=f"{self._place}.{key}" if self._place else key)

    def text(self, key: str, default: str | None = None) -> str:
        """Return a text that is not empty."""
        value = self._value(key, default)
        if not isinstance(value, str) or (not value.strip() and value != default):
            raise self.fail(f"{value!r} is not a text", key)
        return value

    def integer(self, key: str, *, low: int, high: int) -> int:
        """Return a whole number within ``low..high``."""
        value = self._value(key, None)
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise self.fail(f"{value!r} is not a whole number within {low} to {high}", key)
        return value

    def number(self, key: str, default: float | None = None, *, low: float = 0.0, high: float = math.inf) -> float:
        """Return a finite number within ``low..high``."""
        value = self._value(key, default)
        good = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        if not good or not low <= value <= high:
            raise self.fail(f"{value!r} is not a number within {low:g} to {high:g}", key)
        return float(value)

    def numbers(self, key: str) -> tuple[float, ...]:
        """Return a list of finite numbers."""
        values = self._value(key, None)
        if not isinstance(values, list) or not all(_finite(value) for value in values):
            raise self.fail("is not a list of numbers", key)
        return tuple(float(value) for value in values)

    def flag(self, key: str, *, default: bool) -> bool:
        """Return true or false."""
        value = self._value(key, default)
        if not isinstance(value, bool):
            raise self.fail(f"{value!r} is neither true nor false", key)
        return value

    def moment_ns(self, key: str) -> int:
        """Return a time given in ISO 8601 with its offset from UTC, as ns since 1970."""
        return self._moment_ns(key, self._value(key, None))

    def optional_moment_ns(self, key: str) -> int | None:
        """Return the same, or None where it is null or left out."""
        self._taken.add(key)
        value = self._values.get(key)
        return None if value is None else self._moment_ns(key, value)

    def objects(self, key: str) -> list[Fields]:
        """Return a list of objects; an empty one where it is left out."""
        self._taken.add(key)
        values = self._values.get(key, [])
        if not isinstance(values, list):
            raise self.fail("is not a list of objects", key)
        return [self._object(f"{key}[{index}]", value) for index, value in enumerate(values)]

    def one_object(self, key: str) -> Fields:
        """Return an object."""
        return self._object(key, self._value(key, None))

    def optional_object(self, key: str) -> Fields | None:
        """Return an object, or None where it is null or left out."""
        self._taken.add(key)
        value = self._values.get(key)
        return None if value is None else self._object(key, value)

    def has(self, key: str) -> bool:
        """Whether a field is given."""
        return key in self._values

    def end(self) -> None:
        """Check that nothing is left over."""
        for key in self._values:
            if key not in self._taken:
                raise self.fail(f"unknown field; known here: {', '.join(sorted(self._taken))}", key)

    def _value(self, key: str, default: object) -> Any:  # noqa: ANN401 - JSON holds anything
        self._taken.add(key)
        if key in self._values:
            return self._values[key]
        if default is None:
            raise self.fail("is missing", key)
        return default

    def _object(self, key: str, value: object) -> Fields:
        if not isinstance(value, dict):
            raise self.fail("is not an object", key)
        return Fields(value, self._file, f"{self._place}.{key}" if self._place else key)

    def _moment_ns(self, key: str, value: object) -> int:
        try:
            moment = datetime.fromisoformat(value) if isinstance(value, str) else None
        except ValueError:
            moment = None
        if moment is None or moment.tzinfo is None:
            raise self.fail(f"{value!r} is not a time with its offset from UTC, as in 2024-01-08T05:30:00Z", key)
        since = moment - datetime(1970, 1, 1, tzinfo=UTC)
        return (since.days * 86_400_000_000 + since.seconds * 1_000_000 + since.microseconds) * 1000


def _finite(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
