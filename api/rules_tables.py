"""Tables of a rules file: their schemas, from the fields of the rules, and what they change."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from annotated_types import Interval
from pydantic import BaseModel, create_model
from pydantic import Field as Key
from pydantic.types import AllowInfNan

from estimation.alerts.rules.rule import AlertDelays
from ingest.input_file import InputTable

_Value = TypeVar("_Value")

_USUAL_RANGE = Interval(ge=0.0, le=1e9)  # of a number whose rule gives none
_EITHER = (("on_evaluations", "on_delay_km"), ("off_evaluations", "off_delay_km"))


def table_of(value_type: type[Any], without: frozenset[str] = frozenset()) -> type[InputTable]:
    """Return the schema of a table that sets fields of a dataclass; fields with a default may be left out."""
    hints = get_type_hints(value_type, include_extras=True)
    keys: dict[str, Any] = {
        item.name: _key_of(item, hints[item.name]) for item in fields(value_type) if item.name not in without
    }
    return create_model(value_type.__name__, __base__=InputTable, **keys)


def _key_of(item: Field[Any], hint: object) -> tuple[object, object]:
    """Return type and default of a key, as pydantic takes them."""
    default = ... if item.default is MISSING and item.default_factory is MISSING else None
    if is_dataclass(hint) and isinstance(hint, type):
        return table_of(hint) | None, default
    if get_origin(hint) is tuple:
        return Annotated[list[table_of(get_args(hint)[0])], Key(min_length=1)], default  # type: ignore[misc]  # of values
    if hint in (float, int):
        return Annotated[hint, _USUAL_RANGE], default
    if item.default == math.inf:
        return Annotated[hint, AllowInfNan(True)], default  # noqa: FBT003 - its own signature
    return hint, default


def changed(value: _Value, given: BaseModel | None) -> _Value:
    """Return a dataclass with the fields that a table sets.

    A delay that the table sets takes the place of the same delay in the other unit.
    """
    if given is None:
        return value
    found = dict(_set_fields(value, given))
    if isinstance(value, AlertDelays):
        for evaluations, km in _EITHER:
            if evaluations in found:
                found.setdefault(km, 0.0)
    return replace(value, **found)  # type: ignore[type-var]  # a dataclass


def both_units(given: BaseModel | None) -> str | None:
    """Return the key of a delay in kilometres that a table of delays sets beside the same one in evaluations."""
    if given is None:
        return None
    return next((km for evaluations, km in _EITHER if {evaluations, km} <= given.model_fields_set), None)


def _set_fields(value: Any, given: BaseModel) -> Mapping[str, Any]:  # noqa: ANN401 - any dataclass or its type
    found: dict[str, Any] = {}
    hints = get_type_hints(value if isinstance(value, type) else type(value))
    for name in given.model_fields_set:
        item = getattr(given, name)
        if isinstance(item, BaseModel):
            item = changed(getattr(value, name), item)
        elif isinstance(item, list):
            element = get_args(hints[name])[0]
            item = tuple(element(**_set_fields(element, entry)) for entry in item)
        found[name] = float(item) if hints[name] is float else item
    return found
