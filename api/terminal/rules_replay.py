"""What other alert rules would have raised over the stored history, on the terminal."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

from api.factory import SystemClock, open_store
from api.progress import bar
from api.rules_file import load_rules
from api.settings import load_settings
from api.times import from_rfc3339, to_rfc3339
from estimation.alerts.rules.book import RuleBook
from estimation.errors import InputError, NotFoundError
from estimation.jobs.refresh_adhesion import KEPT_NS
from estimation.jobs.rules_replay import (
    DAY_NS,
    NOT_REPLAYED,
    Change,
    Difference,
    differences,
    history_of,
    replayed,
    section_replayed,
)
from estimation.values.alerts import Alert
from fleet_db.storage import SqlStorage, SqlUnitOfWork

_ALL = 2**31
_SHOWN = tuple(change for change in Change if change is not Change.SAME)


def replay(from_: str, to: str | None, file: Path | None, fleet: str | None) -> None:
    """Replay the rules in force and those of a file, and print how their alerts differ."""
    settings, console = load_settings(), Console()
    span = (_moment(from_, "--from"), SystemClock().now_ns() if to is None else _moment(to, "--to"))
    if span[0] >= span[1]:
        raise InputError("the begin is not before the end", field="--from")
    in_force = RuleBook() if settings.rules_file is None else load_rules(settings.rules_file)
    tried = None if file is None else load_rules(file)
    with closing(open_store(settings)) as storage:
        with storage.read() as unit:
            _check_codes(unit, tried or in_force, fleet, console)
        found = _replayed(storage, (in_force, tried or in_force), span, fleet)
    console.print(f"{to_rfc3339(span[0])} to {to_rfc3339(span[1])}", highlight=False, soft_wrap=True)
    console.print(f"rules in force: {in_force.version}", highlight=False, soft_wrap=True)
    if tried is None:
        console.print(_table([one for changes in found.values() for one in changes]))
    else:
        console.print(f"rules tried:    {tried.version}", highlight=False, soft_wrap=True)
        console.print(_summary(found))
        listed = [one for changes in found.values() for one in changes if one.change is not Change.SAME]
        console.print(_table(listed) if listed else "no alert differs")
    console.print(
        f"not replayed: {', '.join(NOT_REPLAYED)}, rejected recordings, grouping into fleet alerts; low_adhesion "
        f"where windows keep their sums of friction, {KEPT_NS // DAY_NS} days; nothing was written",
        highlight=False,
    )


def _moment(text: str, name: str) -> int:
    whole = f"{text}T00:00:00Z" if re.fullmatch(r"\d{4}-\d\d-\d\d", text, re.ASCII) else text
    try:
        return from_rfc3339(whole)
    except ValueError as error:
        raise InputError(f"{text!r} {error}", field=name) from None


def _check_codes(unit: SqlUnitOfWork, book: RuleBook, fleet: str | None, console: Console) -> None:
    """Say which fleets and classes of the rules the registry does not have: nothing follows from them."""
    fleets = {one.code for one in unit.registry.fleets()}
    if fleet is not None and fleet not in fleets:
        raise NotFoundError("fleet", fleet)
    unknown = {f"fleet {one}" for one, _ in book.scoped if one is not None and one not in fleets}
    classes = {one for _, one in book.scoped if one is not None}
    used = {one.vehicle_class for code in fleets for one in unit.registry.vehicles_page(code, None, _ALL)}
    unknown |= {f"class {one}" for one in classes - used}
    for name in sorted(unknown):
        console.print(f"no vehicle is of {name}", highlight=False)


def _replayed(
    storage: SqlStorage, books: tuple[RuleBook, RuleBook], span: tuple[int, int], fleet: str | None
) -> Mapping[str, Sequence[Difference]]:
    """Return the differences by wheelset, and by section and fleet."""
    with storage.read() as unit:
        serials = [one.serial for one in unit.registry.wheelsets() if fleet in (None, one.fleet)]
        sections = [one.code for one in unit.tracks.sections()]
    found: dict[str, Sequence[Difference]] = {}
    with bar(Console(stderr=True), "replaying the rules") as progress:
        for serial in progress.track(serials):
            with storage.read() as unit:
                history = history_of(unit, serial)
            before = replayed(history, books[0], span)
            after = before if books[1] is books[0] else replayed(history, books[1], span)
            found[serial] = differences(before, after)
        for section in sections:
            with storage.read() as unit:
                before = _of_fleet(section_replayed(unit, section, books[0], span), fleet)
                same = books[1] is books[0]
                after = before if same else _of_fleet(section_replayed(unit, section, books[1], span), fleet)
            for one in sorted({alert.fleet for alert in (*before, *after)}):
                found[f"{section} {one}"] = differences(_of_fleet(before, one), _of_fleet(after, one))
    return found


def _of_fleet(alerts: Sequence[Alert], fleet: str | None) -> list[Alert]:
    return [one for one in alerts if fleet in (None, one.fleet)]


def _summary(found: Mapping[str, Sequence[Difference]]) -> Table:
    """Return how many alerts of each kind there are, and how many differ in which way."""
    counts: defaultdict[str, Counter[str]] = defaultdict(Counter)
    for one in (one for changes in found.values() for one in changes):
        kind = _either(one).kind
        counts[kind][one.change] += 1
        counts[kind]["in force"] += one.before is not None
        counts[kind]["tried"] += one.after is not None
    columns = ("in force", "tried", *_SHOWN)
    table = Table("kind", *columns, box=box.SIMPLE_HEAD, pad_edge=False)
    for kind in sorted(counts):
        table.add_row(kind, *(str(counts[kind][column]) for column in columns))
    return table


def _table(listed: Sequence[Difference]) -> Table:
    """Return the alerts in order; where some differ, with the change and the dates by the rules in force."""
    differ = any(one.change is not Change.SAME for one in listed)
    columns = ("wheelset or section", "kind", "severity", "opened", "closed")
    table = Table(*(("change", *columns, "in force") if differ else columns), box=box.SIMPLE_HEAD, pad_edge=False)
    for one in listed:
        alert = _either(one)
        dates = ("", "") if one.after is None else (_day(alert.opened_ns), _day(alert.closed_ns))
        row = [alert.wheelset or alert.track_section, alert.kind, alert.severity.value, *dates]
        before = "" if one.before is None else f"{_day(one.before.opened_ns)} - {_day(one.before.closed_ns)}"
        table.add_row(*([one.change.value, *row, before] if differ else row))
    return table


def _either(one: Difference) -> Alert:
    alert = one.after or one.before
    if alert is None:
        raise AssertionError  # a difference has one of both
    return alert


def _day(t_ns: int | None) -> str:
    return "open" if t_ns is None else to_rfc3339(t_ns)[:10]
