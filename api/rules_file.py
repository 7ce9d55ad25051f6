"""Read alert rules from a TOML file; everything that is not written there keeps its shipped default.

A table is named after the ``kind`` of a rule; its keys are the fields of the rule, and their ranges stand there. What a
file says of the vehicles of a class (``[[class]]``) goes before it, what it says of a fleet (``[[fleet]]``) before
that, and of a class in a fleet before both.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args, get_origin, get_type_hints

from annotated_types import Interval
from pydantic import BaseModel, create_model
from pydantic import Field as Key
from pydantic.types import AllowInfNan

from estimation.alerts.rule_book import AlarmFloodRule, RuleBook
from estimation.alerts.rules.conicity_limit import ConicityLimitRule
from estimation.alerts.rules.rule import AlertDelays, AlertRule
from ingest.input_file import Code, InputFile, InputTable, Location, read_toml

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
    fields_set = dict(_set_fields(value, given))
    if isinstance(value, AlertDelays):
        for evaluations, km in _EITHER:
            if evaluations in fields_set:
                fields_set.setdefault(km, 0.0)
    return replace(value, **fields_set)  # type: ignore[type-var]  # a dataclass


def both_units(given: BaseModel | None) -> str | None:
    """Return the key of a delay in kilometres that a table of delays sets beside the same one in evaluations."""
    if given is None:
        return None
    return next((km for evaluations, km in _EITHER if {evaluations, km} <= given.model_fields_set), None)


def _set_fields(value: Any, given: BaseModel) -> Mapping[str, Any]:  # noqa: ANN401 - any dataclass or its type
    settings: dict[str, Any] = {}
    hints = get_type_hints(value if isinstance(value, type) else type(value))
    for name in given.model_fields_set:
        item = getattr(given, name)
        if isinstance(item, BaseModel):
            item = changed(getattr(value, name), item)
        elif isinstance(item, list):
            element = get_args(hints[name])[0]
            item = tuple(element(**_set_fields(element, entry)) for entry in item)
        settings[name] = float(item) if hints[name] is float else item
    return settings


_RELATIONS = {"<=": (operator.le, "is above"), ">=": (operator.ge, "is below")}


def contradiction(rule: AlertRule) -> tuple[Location, str] | None:
    """Return the field that contradicts another, and why; None where none does."""
    for name, relation, other in rule.relations:
        holds, contrary = _RELATIONS[relation]
        value, limit = getattr(rule, name), getattr(rule, other)
        if not holds(value, limit):
            return (name,), f"{value:g} {contrary} {other} ({limit:g})"
    if not rule.counts_km:
        for name in ("on_delay_km", "off_delay_km"):
            if getattr(rule.delays, name) > 0.0:
                return ("delays", name), f"{rule.kind} has no mileage to count; set evaluations"
    return _of_bands(rule) if isinstance(rule, ConicityLimitRule) else None


def _of_bands(rule: ConicityLimitRule) -> tuple[Location, str] | None:
    seen: set[tuple[str, float]] = set()
    for i, band in enumerate(rule.bands):
        scope = (band.vehicle_class, band.up_to_km_h)
        if scope in seen:
            return ("bands", i), f"{band.vehicle_class!r} up to {band.up_to_km_h:g} km/h is there twice"
        seen.add(scope)
        falls = band.per_km_h < 0.0 and math.isfinite(band.up_to_km_h)
        least = band.at(band.up_to_km_h) if falls else band.limit
        if least <= rule.clear_margin:
            reason = (
                f"the clear limit would not be above 0: {least:g} is not above clear_margin ({rule.clear_margin:g})"
            )
            return ("bands", i, "limit"), reason
    return None


_ALARM_FLOOD = "alarm_flood"
_COMPARED = frozenset({"parameters"})  # of comparisons between all fleets


@dataclass(frozen=True, slots=True)
class _Layer:
    """Tables of rules for a scope: (fleet, class), None where it holds for any."""

    fleet: str | None
    vehicle_class: str | None
    tables: BaseModel
    location: Location

    @property
    def named(self) -> str:
        parts = (("fleet", self.fleet), ("class", self.vehicle_class))
        return ", ".join(f"{what} {code}" for what, code in parts if code is not None)

    def holds(self, fleet: str | None, vehicle_class: str | None) -> bool:
        return self.fleet in (None, fleet) and self.vehicle_class in (None, vehicle_class)


def load_rules(path: Path, book: RuleBook | None = None) -> RuleBook:
    """Return the rule book of a TOML file; an InputError names the file, the line and the field."""
    book = book if book is not None else RuleBook()
    file = read_toml(path)
    given = file.parse(_schema(book))
    everywhere = _with(book, _Layer(None, None, given, ()), file)
    layers = list(_layers(given, file))
    books = {}
    fleets = [None, *dict.fromkeys(layer.fleet for layer in layers if layer.fleet is not None)]
    classes = [None, *dict.fromkeys(layer.vehicle_class for layer in layers if layer.vehicle_class is not None)]
    for scope in product(fleets, classes) if layers else ():
        of_scope = everywhere
        for layer in layers:
            if layer.holds(*scope):
                of_scope = _with(of_scope, layer, file)
        books[scope] = of_scope
    return replace(everywhere, name=getattr(given, "name", None) or "", scoped=books)


def _schema(book: RuleBook) -> type[InputTable]:
    everywhere: dict[str, Any] = {rule.kind: (table_of(type(rule)) | None, None) for rule in book.rules}
    flood: dict[str, Any] = {_ALARM_FLOOD: (table_of(AlarmFloodRule) | None, None)}
    scoped: dict[str, Any] = {rule.kind: (table_of(type(rule), _COMPARED) | None, None) for rule in book.rules}
    of_class = create_model("OfClass", __base__=InputTable, code=(Code, Key(alias="class")), **scoped)
    of_fleet = create_model(
        "OfFleet",
        __base__=InputTable,
        fleet=(Code, ...),
        code=(Code | None, Key(default=None, alias="class")),
        **scoped,
        **flood,
    )
    return create_model(
        "Rules",
        __base__=InputTable,
        name=(Code | None, None),
        classes=(list[of_class], Key(default=[], alias="class")),  # type: ignore[valid-type]  # made here
        fleets=(list[of_fleet], Key(default=[], alias="fleet")),  # type: ignore[valid-type]  # made here
        **everywhere,
        **flood,
    )


def _layers(given: Any, file: InputFile) -> Iterator[_Layer]:  # noqa: ANN401 - of the schema made above
    """Yield what the file says of classes, of fleets, and of classes in fleets: the later go before the earlier."""
    classes = [_Layer(None, of_class.code, of_class, ("class", i)) for i, of_class in enumerate(given.classes)]
    fleets = [_Layer(of_fleet.fleet, of_fleet.code, of_fleet, ("fleet", i)) for i, of_fleet in enumerate(given.fleets)]
    seen: dict[tuple[str | None, str | None], _Layer] = {}
    for layer in (*classes, *fleets):
        scope = (layer.fleet, layer.vehicle_class)
        if scope in seen:
            raise file.error(f"{layer.named} is there twice", layer.location)
        seen[scope] = layer
        if layer.vehicle_class is not None and getattr(layer.tables, _ALARM_FLOOD, None) is not None:
            raise file.error("is of a whole fleet: leave `class` out", (*layer.location, _ALARM_FLOOD))
    yield from sorted(seen.values(), key=lambda layer: (layer.fleet is not None, layer.vehicle_class is not None))


def _with(book: RuleBook, layer: _Layer, file: InputFile) -> RuleBook:
    rules = []
    for rule in book.rules:
        table = getattr(layer.tables, rule.kind)
        of_table = changed(rule, table)
        if table is not None:
            twice = both_units(getattr(table, "delays", None))
            if twice is not None:
                reason = (
                    f"a delay is in evaluations or in kilometres: leave {twice.replace('delay_km', 'evaluations')} out"
                )
                raise file.error(reason, (*layer.location, rule.kind, "delays", twice))
            wrong = contradiction(of_table)
            if wrong is not None:
                where, reason = wrong
                scope = f", for {layer.named}" if layer.named else ""
                raise file.error(reason + scope, (*layer.location, rule.kind, *where))
        rules.append(of_table)
    flood = changed(book.alarm_flood, getattr(layer.tables, _ALARM_FLOOD, None))
    return replace(book, rules=tuple(rules), alarm_flood=flood)


def resolved(book: RuleBook) -> Mapping[str, RuleBook]:
    """Return the book of every scope that a file names, by the name of the scope."""
    books = {"all fleets and classes": book}
    for (fleet, vehicle_class), rules in book.scoped.items():
        names = [f"{what} {code}" for what, code in (("fleet", fleet), ("class", vehicle_class)) if code is not None]
        if names:
            books[", ".join(names)] = rules
    return books
