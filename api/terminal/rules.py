"""Alert rules on the terminal: what a file leads to, by fleet and class."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass

from rich import box
from rich.console import Console
from rich.table import Table

from api.rules_file import resolved
from estimation.alerts.rules.book import RuleBook
from estimation.alerts.rules.conicity_limit import SpeedBand

_Settings = dict[tuple[str, str], str]


def print_rules(book: RuleBook) -> None:
    """Print the rules of all fleets and classes, and for every scope what it has of its own."""
    console = Console()
    console.print(f"version: {book.version}", highlight=False)
    shipped, everywhere = _settings(RuleBook()), _settings(book)
    console.print("\nall fleets and classes (* differs from the shipped rules)", highlight=False)
    console.print(_table(everywhere, shipped))
    for scope, one in resolved(book).items():
        if one is book:
            continue
        own = {key: value for key, value in _settings(one).items() if everywhere.get(key) != value}
        console.print(f"\n{scope}: all of the above but", highlight=False)
        console.print(_table(own, shipped) if own else "  nothing")


def _table(settings: _Settings, shipped: _Settings) -> Table:
    table = Table("rule", "setting", "value", box=box.SIMPLE_HEAD, pad_edge=False)
    before = ""
    for (kind, name), value in settings.items():
        mark = "" if shipped.get((kind, name)) == value else " *"
        table.add_row("" if kind == before else kind, name, value + mark)
        before = kind
    return table


def _settings(book: RuleBook) -> _Settings:
    """Return every setting as text, by rule and name."""
    found = {(rule.kind, name): value for rule in book.rules for name, value in _flat(rule)}
    return found | {("alarm_flood", name): value for name, value in _flat(book.alarm_flood)}


def _flat(value: object, prefix: str = "") -> Iterator[tuple[str, str]]:
    if not is_dataclass(value):
        return
    for item in fields(value):
        one = getattr(value, item.name)
        if is_dataclass(one):
            yield from _flat(one, f"{prefix}{item.name}.")
        elif isinstance(one, tuple):
            yield from ((f"{prefix}{item.name}[{i}]", _band(band)) for i, band in enumerate(one))
        else:
            yield f"{prefix}{item.name}", f"{one:g}" if isinstance(one, float) else str(one)


def _band(band: SpeedBand) -> str:
    of_class = "any class" if band.vehicle_class == "*" else band.vehicle_class
    falls = f" {band.per_km_h:+.6g} a km/h" if band.per_km_h else ""
    speed = "any speed" if math.isinf(band.up_to_km_h) else f"up to {band.up_to_km_h:g} km/h"
    return f"{of_class}, {speed}: {band.limit:g}{falls}"
