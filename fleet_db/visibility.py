"""What a caller who is bound to fleets sees of the database: every SELECT of a bound connection is narrowed.

The rule stands here once, below all stores, and is closed by default: a statement over a table that is not listed here
is refused on a bound connection. Writing transactions are not narrowed, for numbers and locks count everything; who
writes first reads on a bound connection what it is about to change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

from sqlalchemy import ColumnElement, Connection, FromClause, Select, Table, and_, event, false, func, or_, select
from sqlalchemy.sql import Executable, visitors
from sqlalchemy.sql.selectable import Alias, Join

from fleet_db.rows import table_of
from fleet_db.tables.alerts import AlertRow, WebhookFleetRow
from fleet_db.tables.recordings import ChunkRow
from fleet_db.tables.registry import VehicleRow, WheelsetRow

Fleets = frozenset[str]
Columns = Any  # the columns of a table or of an alias of it
Rule = Callable[[Columns, Fleets], ColumnElement[bool]]
_VEHICLES, _WHEELSETS, _ALERTS = table_of(VehicleRow), table_of(WheelsetRow), table_of(AlertRow)
_CHUNKS, _WEBHOOK_FLEETS = table_of(ChunkRow), table_of(WebhookFleetRow)


def _of_fleet(columns: Columns, fleets: Fleets) -> ColumnElement[bool]:
    return _among(columns.fleet, fleets)


def _among(column: ColumnElement[str], fleets: Fleets) -> ColumnElement[bool]:
    return column.in_(sorted(fleets))


def _both(first: Rule, second: Rule) -> Rule:
    return lambda columns, fleets: first(columns, fleets) & second(columns, fleets)


def _of_webhook(columns: Columns, fleets: Fleets) -> ColumnElement[bool]:
    """Return whether a webhook is of a key that is bound to some of the fleets and to no other."""
    named = _WEBHOOK_FLEETS.alias()
    of_others = select(named.c.webhook_id).where(~_among(named.c.fleet, fleets)).correlate(None)
    return and_(_in(columns.webhook_id, _WEBHOOK_FLEETS, "webhook_id", fleets), columns.webhook_id.not_in(of_others))


def _in(column: ColumnElement[Any], owner: Table, key: str, fleets: Fleets) -> ColumnElement[bool]:
    """Return whether a column names a record of the owning table that belongs to the fleets."""
    named = owner.alias()  # another name, so that it is never taken for a table of the statement around it
    return column.in_(select(named.c[key]).where(_among(named.c.fleet, fleets)).correlate(None))


def _naming(column: str, owner: Table, key: str) -> Rule:
    return lambda columns, fleets: _in(columns[column], owner, key, fleets)


_of_vehicle = _naming("vehicle", _VEHICLES, "code")
_of_wheelset = _naming("wheelset", _WHEELSETS, "serial")

_OF_WHEELSETS = ("mounting", "reprofiling", "measurement", "wheelset")  # kinds of records
_OF_VEHICLES = ("vehicle", "sensor_change")


def _of_subject(columns: Columns, fleets: Fleets) -> ColumnElement[bool]:
    of_wheelset = and_(columns.kind.in_(_OF_WHEELSETS), _in(columns.subject, _WHEELSETS, "serial", fleets))
    of_vehicle = and_(columns.kind.in_(_OF_VEHICLES), _in(columns.subject, _VEHICLES, "code", fleets))
    return or_(of_wheelset, of_vehicle)


def _of_result(columns: Columns, fleets: Fleets) -> ColumnElement[bool]:
    return or_(
        and_(columns.kind == "wheelset", _in(columns.subject, _WHEELSETS, "serial", fleets)),
        and_(columns.kind == "vehicle", _in(columns.subject, _VEHICLES, "code", fleets)),
        columns.kind == "section",
    )


def _of_quarantined(columns: Columns, fleets: Fleets) -> ColumnElement[bool]:
    """Return what is kept apart of recordings, windows, wheelsets and vehicles of the fleets; sections are of none."""
    chunks, serials = _CHUNKS.alias(), _WHEELSETS.alias()
    digests = select(chunks.c.digest).where(_of_vehicle(chunks.c, fleets)).correlate(None)
    begins = func.substr(columns.key, 1, func.length(serials.c.serial) + 1) == serials.c.serial + "@"
    of_windows = select(serials.c.serial).where(_among(serials.c.fleet, fleets), begins).exists()
    return or_(
        and_(columns.kind == "recording", columns.key.in_(digests)),
        and_(columns.kind == "window", of_windows),
        and_(columns.kind == "wheelset", _in(columns.key, _WHEELSETS, "serial", fleets)),
        and_(columns.kind == "vehicle", _in(columns.key, _VEHICLES, "code", fleets)),
        and_(columns.kind == "fleet", _among(columns.key, fleets)),
    )


RULES: Mapping[str, Rule] = {
    "registry_events": _of_subject,
    "quarantine": _of_quarantined,
    "fleets": lambda columns, fleets: _among(columns.code, fleets),
    "alert_events": _naming("alert_id", _ALERTS, "alert_id"),
    "recording_changes": _both(*(_naming(f"vehicle_{time}", _VEHICLES, "code") for time in ("before", "after"))),
    "results": _of_result,
    **dict.fromkeys(("vehicles", "wheelsets", "alerts", "worklist_entries"), _of_fleet),
    **dict.fromkeys(("chunks", "sensor_changes", "stale_spans", "track_epoch_vehicles"), _of_vehicle),
    **dict.fromkeys(("suspension_findings", "window_dampers"), _of_vehicle),
    **dict.fromkeys(("mountings", "windows", "track_epoch_windows"), _both(_of_wheelset, _of_vehicle)),
    **dict.fromkeys(("reprofilings", "measured_profiles", "wheelset_bins", "worklist_alerts"), _of_wheelset),
    **dict.fromkeys(("window_bin_tables", "window_positions", "window_adhesion", "wear_signatures"), _of_wheelset),
    **dict.fromkeys(("rail_cells", "roll_ups", "roll_up_states", "rolling_sums"), _of_wheelset),
    **dict.fromkeys(("webhooks", "webhook_fleets", "webhook_deliveries"), _of_webhook),
}
SHARED = frozenset(
    {
        *("feed_branches", "idempotency_keys", "job_runs", "purges", "section_adhesion", "stored_settings"),
        *("track_alignments", "track_epochs", "track_layouts", "track_reports", "track_sections", "track_versions"),
        *("vehicle_classes", "work_leases", "alembic_version"),
    }
)
"""Tables of no fleet. What a row of them says of a fleet's vehicles is left out by its representation."""
HIDDEN = frozenset(
    {
        *("api_keys", "audit_entries", "raw_marks", "raw_scrubs", "stage_marks", "subject_versions"),
        *("webhook_secrets", "window_due", "work_claims"),
    }
)
"""Tables that a bound caller does not see at all."""


def bind(connection: Connection, fleets: Fleets) -> None:
    """Let every statement of a connection see only these fleets."""

    def narrow(_: Connection, statement: Executable, several: Any, given: Any, _options: object) -> tuple[Any, ...]:  # noqa: ANN401
        return narrowed(statement, fleets), several, given

    event.listen(connection, "before_execute", narrow, retval=True)


def narrowed(statement: Any, fleets: Fleets) -> Any:  # noqa: ANN401 - any statement
    """Return a statement that sees, also in subqueries, only these fleets; LookupError: a table not listed here."""

    def narrow(clone: Select[Any]) -> None:
        criteria = [
            _criterion(source, table, fleets, or_absent=or_absent)
            for source, table, or_absent in _tables(clone.get_final_froms())
        ]
        # SQLAlchemy's way to visit clones: they are changed in place, where `where` would return another one
        narrower = [criterion for criterion in criteria if criterion is not None]
        clone._where_criteria += tuple(narrower)  # noqa: SLF001 - the same

    return visitors.cloned_traverse(statement, {}, {"select": narrow})


def _tables(sources: Iterable[FromClause], *, or_absent: bool = False) -> Iterator[tuple[FromClause, Table, bool]]:
    """Yield the tables of FROM with the name under which each is read, and whether its columns may be absent."""
    for source in sources:
        if isinstance(source, Table):
            yield source, source, or_absent
        elif isinstance(source, Join):
            yield from _tables([source.left], or_absent=or_absent or source.full)
            yield from _tables([source.right], or_absent=or_absent or source.full or source.isouter)
        elif isinstance(source, Alias) and isinstance(source.element, Table):
            yield source, source.element, or_absent


def _criterion(source: FromClause, table: Table, fleets: Fleets, *, or_absent: bool) -> ColumnElement[bool] | None:
    if table.name in SHARED:
        return None
    if table.name in HIDDEN:
        return false()
    rule = RULES.get(table.name)
    if rule is None:
        raise LookupError(f"fleet_db/visibility.py does not say which fleets see the table {table.name}")
    criterion = rule(source.c, fleets)
    if not or_absent:
        return criterion
    (key, *_) = table.primary_key.columns
    return criterion | source.c[key.name].is_(None)
