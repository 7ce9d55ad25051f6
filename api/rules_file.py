"""Read alert rules from a TOML file; everything that is not written there keeps its shipped default.

::

    [conicity_limit]
    raise_probability = 0.9
    delays = { on_evaluations = 2 }

    [[conicity_limit.bands]]
    vehicle_class = "freight"
    up_to_km_h = 120
    limit = 0.45

A table is named after the ``kind`` of a rule; its keys are the fields of the rule, and their ranges stand there.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from annotated_types import Interval
from pydantic import BaseModel, create_model
from pydantic import Field as Key
from pydantic.types import AllowInfNan

from estimation.alerts.rules.book import AlarmFloodRule, RuleBook
from estimation.alerts.rules.rule import AlertRule
from ingest.input_file import InputFile, InputTable, read_toml

_Value = TypeVar("_Value")

_USUAL_RANGE = Interval(ge=0.0, le=1e9)  # of a number whose rule gives none
_RELATIONS = {"<=": (operator.le, "is above"), ">=": (operator.ge, "is below")}
_ALARM_FLOOD = "alarm_flood"


def load_rules(path: Path, book: RuleBook | None = None) -> RuleBook:
    """Return the rule book of a TOML file.

    Parameters
    ----------
    path
        The file.
    book
        What it changes; the shipped rules by default.

    Raises
    ------
    InputError
        The file cannot be read or is no TOML; an unknown table or key; a value of the wrong type or outside its range;
        a clear limit on the wrong side of its raise limit. Names the file, the line and the field.
    """
    book = book if book is not None else RuleBook()
    file = read_toml(path)
    tables: dict[str, Any] = {rule.kind: (_table_of(type(rule)) | None, None) for rule in book.rules}
    tables[_ALARM_FLOOD] = (_table_of(AlarmFloodRule) | None, None)
    model = create_model("Rules", __base__=InputTable, **tables)
    given = file.parse(model)
    rules = [_changed(rule, getattr(given, rule.kind)) for rule in book.rules]
    for rule in rules:
        _check_relations(rule, file)
    return replace(book, rules=tuple(rules), alarm_flood=_changed(book.alarm_flood, getattr(given, _ALARM_FLOOD)))


def _table_of(value_type: type[Any]) -> type[InputTable]:
    """Return the schema of a table that sets fields of a dataclass; fields with a default may be left out."""
    hints = get_type_hints(value_type, include_extras=True)
    keys: dict[str, Any] = {item.name: _key_of(item, hints[item.name]) for item in fields(value_type)}
    return create_model(value_type.__name__, __base__=InputTable, **keys)


def _key_of(item: Field[Any], hint: object) -> tuple[object, object]:
    """Return type and default of a key, as pydantic takes them."""
    default = ... if item.default is MISSING and item.default_factory is MISSING else None
    if is_dataclass(hint) and isinstance(hint, type):
        return _table_of(hint) | None, default
    if get_origin(hint) is tuple:
        return Annotated[list[_table_of(get_args(hint)[0])], Key(min_length=1)], default  # type: ignore[misc]  # of values
    if hint in (float, int):
        return Annotated[hint, _USUAL_RANGE], default
    if item.default == math.inf:
        return Annotated[hint, AllowInfNan(True)], default  # noqa: FBT003 - its own signature
    return hint, default


def _changed(value: _Value, given: BaseModel | None) -> _Value:
    """Return a dataclass with the fields that a table sets."""
    if given is None:
        return value
    return replace(value, **_set_fields(value, given))  # type: ignore[type-var]  # a dataclass


def _set_fields(value: Any, given: BaseModel) -> Mapping[str, Any]:  # noqa: ANN401 - any dataclass or its type
    found: dict[str, Any] = {}
    hints = get_type_hints(value if isinstance(value, type) else type(value))
    for name in given.model_fields_set:
        item = getattr(given, name)
        if isinstance(item, BaseModel):
            item = _changed(getattr(value, name), item)
        elif isinstance(item, list):
            element = get_args(hints[name])[0]
            item = tuple(element(**_set_fields(element, entry)) for entry in item)
        found[name] = float(item) if hints[name] is float else item
    return found


def _check_relations(rule: AlertRule, file: InputFile) -> None:
    for name, relation, other in rule.relations:
        holds, contrary = _RELATIONS[relation]
        value, limit = getattr(rule, name), getattr(rule, other)
        if not holds(value, limit):
            raise file.error(f"{value:g} {contrary} {other} ({limit:g})", (rule.kind, name))
