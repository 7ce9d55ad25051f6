"""Input files in TOML and JSON: read, checked by a pydantic model, and refused with file, line and field.

A file that has a schema subclasses ``InputTable`` for its tables (TOML) or objects (JSON)::

    class Fleet(InputTable):
        code: Text
        axles: int = Field(ge=1, le=8)

    fleet = read_toml(path).parse(Fleet)
"""

from __future__ import annotations

import ctypes
import json
import os
import re
import resource
import signal
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import ErrorDetails, PydanticCustomError

from estimation.errors import InputError

MEBIBYTE = 1 << 20
SETTINGS_BYTES = 64 * MEBIBYTE  # of a TOML, JSON or DBC file: a registry of ten thousand vehicles has 40 MiB
TABLE_BYTES = 256 * MEBIBYTE  # of a table of text: an hour at 250 Hz with 25 columns has 225 MiB
PROFILE_BYTES = 16 * MEBIBYTE


def read_text_within(
    path: Path, most: int, error_type: type[InputError], *, encoding: str = "utf-8", errors: str = "strict"
) -> str:
    """Return the content of a text file, without the byte order mark that some editors put first."""
    try:
        with path.open("rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise error_type(f"cannot be read: {error.strerror or error}", file=path) from error
    if len(content) > most:
        raise error_type(f"has more than {most / MEBIBYTE:.0f} MiB, the limit for such a file", file=path)
    try:
        return content.decode(encoding, errors).removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    except UnicodeDecodeError as error:
        raise error_type("is no text file", file=path) from error


PR_SET_PDEATHSIG = 1


def end_with(parent: int) -> None:
    """Let this process end when the one that started it ends."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != parent:  # it had ended before
            os._exit(0)


def limit_memory(more_bytes: int) -> None:
    """Let this process have so many bytes of address space more than it has now."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    space = pages * resource.getpagesize() + more_bytes
    resource.setrlimit(resource.RLIMIT_AS, (space, space))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


Location = tuple[str | int, ...]
Model = TypeVar("Model", bound=BaseModel)
Values = TypeVar("Values", bound=Sequence[float])

_HEADER = re.compile(r"^\s*(\[\[|\[)\s*([A-Za-z0-9_.\-]+)\s*\]")
_KEY = re.compile(r"^\s*([A-Za-z0-9_\-]+)\s*=")


class InputTable(BaseModel):
    """A table whose keys are all known, each of exactly its type; a number is finite."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def field_error(reason: str, *location: str | int) -> PydanticCustomError:
    """Return the error that a validator of an ``InputTable`` raises.

    The location leads from the validated value to what is wrong; none is the value itself.
    """
    return PydanticCustomError("field_error", "{reason}", {"reason": reason, "location": location})


def refusing(is_wrong: Callable[[Any], object], reason: str) -> AfterValidator:
    """Return the validator that refuses values for a reason, which may contain ``{value}``."""

    def check(value: Any) -> Any:  # noqa: ANN401 - of any field
        if is_wrong(value):
            raise field_error(reason.format(value=value))
        return value

    return AfterValidator(check)


def _one_short_line(text: str) -> str:
    if len(text) > CODE_LENGTH:
        raise field_error(f"has {len(text)} letters, at most {CODE_LENGTH}")
    if "\n" in text or "\t" in text:
        raise field_error(f"{text!r} has a control character")
    return text


def increasing(values: Values) -> Values:
    """Refuse numbers that do not increase."""
    if any(later <= earlier for earlier, later in pairwise(values)):
        raise field_error("the list must increase")
    return values


CODE_LENGTH = 64  # letters of a code or a serial number that a database column holds
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")
FreeText = Annotated[str, refusing(_CONTROL.search, "{value!r} has a control character")]
Text = Annotated[FreeText, refusing(lambda text: not text.strip(), "must not be empty")]
Code = Annotated[Text, AfterValidator(_one_short_line)]
NotNegative = Annotated[float, Field(ge=0.0)]
Positive = Annotated[float, Field(gt=0.0)]


@dataclass(frozen=True, slots=True)
class InputFile:
    """The content of an input file, and where in the file each key stands."""

    path: Path
    values: Mapping[str, Any]
    lines: Mapping[Location, int] = field(default_factory=dict)  # by location, from 1; empty for JSON
    error_type: type[InputError] = InputError
    container: str = "a table"  # what the format calls keys with values

    def error(self, reason: str, location: Location = ()) -> InputError:
        """Return the error that names file, line and field."""
        written = (self.lines[location[:n]] for n in range(len(location), -1, -1) if location[:n] in self.lines)
        return self.error_type(reason, file=self.path, line=next(written, None), field=dotted(location) or None)

    def at(self, location: Location) -> Any:  # noqa: ANN401 - whatever the file holds there
        """Return what is at a place of the file."""
        value: Any = self.values
        for part in location:
            value = value[part]
        return value

    def parse(self, model: type[Model], location: Location = ()) -> Model:
        """Return the content, or what is at a place of it, as a model.

        Raises ``error_type`` of the first error in the order of the schema.
        """
        try:
            return model.model_validate(self.at(location), context=self.path.parent)
        except ValidationError as error:
            raise self._errors(error, model, location)[0] from error

    def problems(self, model: type[Model]) -> list[InputError]:
        """Return everything that is wrong with the content as a model, in the order of the schema; see ``parse``."""
        try:
            model.model_validate(self.values)
        except ValidationError as error:
            return self._errors(error, model, ())
        return []

    def _errors(self, error: ValidationError, model: type[BaseModel], location: Location) -> list[InputError]:
        errors = []
        for detail in error.errors(include_url=False):
            place = (*location, *detail["loc"], *detail.get("ctx", {}).get("location", ()))
            errors.append(self.error(_reason(detail, model, self.container), place))
        return errors


def read_toml(path: Path, error_type: type[InputError] = InputError) -> InputFile:
    """Return the content of a TOML file."""
    return parse_toml(read_text_within(path, SETTINGS_BYTES, error_type), path, error_type)


def parse_toml(text: str, path: Path, error_type: type[InputError] = InputError) -> InputFile:
    """Return the content of a TOML text."""
    try:
        return InputFile(path, tomllib.loads(text), key_lines(text), error_type)
    except tomllib.TOMLDecodeError as error:
        raise error_type(f"is no TOML file: {error}", file=path) from error
    except RecursionError as error:
        raise error_type("is nested too deep", file=path) from error


def read_json(path: Path, error_type: type[InputError] = InputError) -> InputFile:
    """Return the content of a JSON file that holds one object."""
    text = read_text_within(path, SETTINGS_BYTES, error_type)
    try:
        values = json.loads(text)
    except json.JSONDecodeError as error:
        raise error_type(f"is no JSON: {error.msg}", file=path, line=error.lineno) from error
    except RecursionError as error:
        raise error_type("is nested too deep", file=path) from error
    if not isinstance(values, dict):
        raise error_type("must hold one object", file=path)
    return InputFile(path, values, error_type=error_type, container="an object")


def key_lines(text: str) -> dict[Location, int]:
    """Return the line (from 1) of every table header and bare key of a TOML text."""
    lines: dict[Location, int] = {}
    counts: dict[Location, int] = {}
    table: Location = ()
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            table = _table_location(header[2].split("."), counts, is_array=header[1] == "[[")
            lines.setdefault(table, number)
        elif key := _KEY.match(line):
            lines.setdefault((*table, key[1]), number)
    return lines


def _table_location(names: Sequence[str], counts: dict[Location, int], *, is_array: bool) -> Location:
    """Return the location of a header, with the index of the current element of every array of tables in it."""
    location: Location = ()
    for depth, name in enumerate(names, start=1):
        location = (*location, name)
        if is_array and depth == len(names):
            counts[location] = counts.get(location, -1) + 1
        if location in counts:
            location = (*location, counts[location])
    return location


def dotted(location: Location) -> str:
    """Return a location as in ``vehicles[1].wheelsets[0].serial``."""
    text = ""
    for part in location:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


# the sentence of each kind of error of pydantic; {value} is what the file holds
_REASONS: Mapping[str, str] = {
    "missing": "is missing",
    "field_error": "{reason}",
    "string_type": "{value!r} is not a text",
    "int_type": "{value!r} is not a whole number",
    "int_from_float": "{value!r} is not a whole number",
    "float_type": "{value!r} is not a number",
    "bool_type": "{value!r} is neither true nor false",
    "datetime_type": "{value!r} is not a date and time",
    "list_type": "{value!r} is not a list",
    "model_type": "{value!r} is not {container}",
    "finite_number": "{value} is not a finite number",
    "greater_than": "{value} is outside the range: must be greater than {gt:g}",
    "greater_than_equal": "{value} is outside the range: at least {ge:g}",
    "less_than": "{value} is outside the range: must be less than {lt:g}",
    "less_than_equal": "{value} is outside the range: at most {le:g}",
    "too_short": "must have at least {min_length} entries",
    "too_long": "{actual_length} entries, at most {max_length}",
    "literal_error": "{value!r} is none of {expected}",
}


def _reason(error: ErrorDetails, model: type[BaseModel], container: str) -> str:
    if error["type"] == "extra_forbidden":
        for part in error["loc"][:-1]:
            fields = {item.alias or name: item for name, item in model.model_fields.items()}
            if part in fields:
                model = _model_in(fields[str(part)].annotation) or model
        keys = sorted(item.alias or name for name, item in model.model_fields.items())
        return f"unknown key; known here: {', '.join(keys)}"
    sentence = _REASONS.get(error["type"])
    if sentence is None:
        return error["msg"]
    return sentence.format(value=error["input"], container=container, **error.get("ctx", {}))


def _model_in(annotation: object) -> type[BaseModel] | None:
    """Return the model that an annotation holds, as ``Model``, ``list[Model]`` or ``Model | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((nested for item in get_args(annotation) if (nested := _model_in(item))), None)
