"""Alert rules on the terminal: what a file leads to by fleet and class, and what it would have raised over history."""

from __future__ import annotations

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import fields, is_dataclass
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from api.factory import SystemClock, open_store
from api.rules_file import load_rules, resolved
from api.settings import load_settings
from api.terminal.progress import bar
from api.terminal.store import print_line
from api.times import from_rfc3339, to_rfc3339
from estimation.alerts.rule_book import RuleBook
from estimation.alerts.rules.conicity_limit import SpeedBand
from estimation.errors import InputError, NotFoundError
from estimation.jobs.parameters import WORK
from estimation.jobs.rules_replay import (
    NOT_REPLAYED,
    Change,
    Difference,
    differences,
    history_of,
    replayed,
    section_replayed,
)
from estimation.values.alerts import Alert
from estimation.values.units import DAY_NS
from fleet_db.storage import SqlStorage, SqlUnitOfWork

_Settings = dict[tuple[str, str], str]


def print_rules(book: RuleBook) -> None:
    """Print the rules of all fleets and classes, and for every scope what it has of its own."""
    console = Console()
    console.print(f"version: {book.version}", highlight=False)
    shipped, everywhere = _settings(RuleBook()), _settings(book)
    console.print("\nall fleets and classes (* differs from the shipped rules)", highlight=False)
    console.print(_settings_table(everywhere, shipped))
    for scope, of_scope in resolved(book).items():
        if of_scope is book:
            continue
        differing = {key: value for key, value in _settings(of_scope).items() if everywhere.get(key) != value}
        console.print(f"\n{scope}: all of the above but", highlight=False)
        console.print(_settings_table(differing, shipped) if differing else "  nothing")


def _settings_table(settings: _Settings, shipped: _Settings) -> Table:
    table = Table("rule", "setting", "value", box=box.SIMPLE_HEAD, pad_edge=False)
    before = ""
    for (kind, name), value in settings.items():
        mark = "" if shipped.get((kind, name)) == value else " *"
        table.add_row("" if kind == before else kind, name, value + mark)
        before = kind
    return table


def _settings(book: RuleBook) -> _Settings:
    settings = {(rule.kind, name): value for rule in book.rules for name, value in _flat(rule)}
    return settings | {("alarm_flood", name): value for name, value in _flat(book.alarm_flood)}


def _flat(value: object, prefix: str = "") -> Iterator[tuple[str, str]]:
    if not is_dataclass(value):
        return
    for item in fields(value):
        setting = getattr(value, item.name)
        if is_dataclass(setting):
            yield from _flat(setting, f"{prefix}{item.name}.")
        elif isinstance(setting, tuple):
            yield from ((f"{prefix}{item.name}[{i}]", _band(band)) for i, band in enumerate(setting))
        else:
            yield f"{prefix}{item.name}", f"{setting:g}" if isinstance(setting, float) else str(setting)


def _band(band: SpeedBand) -> str:
    of_class = "any class" if band.vehicle_class == "*" else band.vehicle_class
    slope = f" {band.per_km_h:+.6g} per km/h" if band.per_km_h else ""
    speed = "any speed" if math.isinf(band.up_to_km_h) else f"up to {band.up_to_km_h:g} km/h"
    return f"{of_class}, {speed}: {band.limit:g}{slope}"


_ALL = 2**31
_SHOWN = tuple(change for change in Change if change is not Change.SAME)


def replay(from_: str, to: str | None, file: Path | None, fleet: str | None) -> None:
    """Replay the rules in force, and print their alerts; with a file, how the alerts of its rules differ."""
    settings, console = load_settings(), Console()
    span = (_moment(from_, "--from"), SystemClock().now_ns() if to is None else _moment(to, "--to"))
    if span[0] >= span[1]:
        raise InputError("the begin is not before the end", field="--from")
    in_force = RuleBook() if settings.rules_file is None else load_rules(settings.rules_file)
    tried = None if file is None else load_rules(file)
    with closing(open_store(settings)) as storage:
        with storage.read() as unit:
            _report_unknown_scopes(unit, tried or in_force, fleet, console)
        changed = _replayed(storage, (in_force, tried or in_force), span, fleet)
    print_line(console, f"{to_rfc3339(span[0])} to {to_rfc3339(span[1])}")
    print_line(console, f"rules in force: {in_force.version}")
    if tried is None:
        console.print(_alerts_table([change for changes in changed.values() for change in changes]))
    else:
        print_line(console, f"rules tried:    {tried.version}")
        console.print(_summary(changed))
        listed = [change for changes in changed.values() for change in changes if change.change is not Change.SAME]
        console.print(_alerts_table(listed) if listed else "no alert differs")
    console.print(
        f"not replayed: {', '.join(NOT_REPLAYED)}, rejected recordings, grouping into fleet alerts; low_adhesion "
        f"before the last {WORK.sums_kept_ns // DAY_NS} days, whose windows keep their sums; nothing was written",
        highlight=False,
    )


def _moment(text: str, name: str) -> int:
    whole = f"{text}T00:00:00Z" if re.fullmatch(r"\d{4}-\d\d-\d\d", text, re.ASCII) else text
    try:
        return from_rfc3339(whole)
    except ValueError as error:
        raise InputError(f"{text!r} {error}", field=name) from None


def _report_unknown_scopes(unit: SqlUnitOfWork, book: RuleBook, fleet: str | None, console: Console) -> None:
    """Refuse an unknown ``fleet``; say which fleets of the rules are not on file, and which classes no vehicle has."""
    fleets = {record.code for record in unit.registry.fleets()}
    if fleet is not None and fleet not in fleets:
        raise NotFoundError("fleet", fleet)
    unknown = {f"fleet {code}" for code, _ in book.scoped if code is not None and code not in fleets}
    classes = {code for _, code in book.scoped if code is not None}
    used = {vehicle.vehicle_class for code in fleets for vehicle in unit.registry.vehicles_page(code, None, _ALL)}
    unknown |= {f"class {code}" for code in classes - used}
    for name in sorted(unknown):
        console.print(f"no vehicle is of {name}", highlight=False)


def _replayed(
    storage: SqlStorage, books: tuple[RuleBook, RuleBook], span: tuple[int, int], fleet: str | None
) -> Mapping[str, Sequence[Difference]]:
    with storage.read() as unit:
        serials = [wheelset.serial for wheelset in unit.registry.wheelsets() if fleet in (None, wheelset.fleet)]
        sections = [section.code for section in unit.tracks.sections()]
    changed: dict[str, Sequence[Difference]] = {}
    with bar(Console(stderr=True), "replaying the rules") as progress:
        for serial in progress.track(serials):
            with storage.read() as unit:
                history = history_of(unit, serial)
            before = replayed(history, books[0], span)
            after = before if books[1] is books[0] else replayed(history, books[1], span)
            changed[serial] = differences(before, after)
        for section in sections:
            with storage.read() as unit:
                before = _of_fleet(section_replayed(unit, section, books[0], span), fleet)
                same = books[1] is books[0]
                after = before if same else _of_fleet(section_replayed(unit, section, books[1], span), fleet)
            for code in sorted({alert.fleet for alert in (*before, *after)}):
                changed[f"{section} {code}"] = differences(_of_fleet(before, code), _of_fleet(after, code))
    return changed


def _of_fleet(alerts: Sequence[Alert], fleet: str | None) -> list[Alert]:
    return [alert for alert in alerts if fleet in (None, alert.fleet)]


def _summary(changed: Mapping[str, Sequence[Difference]]) -> Table:
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for change in (change for changes in changed.values() for change in changes):
        kind = _either(change).kind
        counts[kind][change.change] += 1
        counts[kind]["in force"] += change.before is not None
        counts[kind]["tried"] += change.after is not None
    columns = ("in force", "tried", *_SHOWN)
    table = Table("kind", *columns, box=box.SIMPLE_HEAD, pad_edge=False)
    for kind in sorted(counts):
        table.add_row(kind, *(str(counts[kind][column]) for column in columns))
    return table


def _alerts_table(listed: Sequence[Difference]) -> Table:
    """Return the alerts in order; where some differ, with the change and the dates by the rules in force."""
    differ = any(difference.change is not Change.SAME for difference in listed)
    columns = ("wheelset or section", "kind", "severity", "opened", "closed")
    table = Table(*(("change", *columns, "in force") if differ else columns), box=box.SIMPLE_HEAD, pad_edge=False)
    for difference in listed:
        alert = _either(difference)
        dates = ("", "") if difference.after is None else (_day(alert.opened_ns), _day(alert.closed_ns))
        row = [alert.wheelset or alert.track_section, alert.kind, alert.severity.value, *dates]
        before, was = "", difference.before
        if was is not None:
            before = f"{_day(was.opened_ns)} - {_day(was.closed_ns)}"
        table.add_row(*([difference.change.value, *row, before] if differ else row))
    return table


def _either(difference: Difference) -> Alert:
    alert = difference.after or difference.before
    if alert is None:
        raise AssertionError  # a difference has one of both
    return alert


def _day(t_ns: int | None) -> str:
    return "open" if t_ns is None else to_rfc3339(t_ns)[:10]
