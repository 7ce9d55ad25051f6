"""Codes beside the sentences of reasons, and statuses of bins as codes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sqlalchemy as sa
from alembic import op

from fleet_db.former_reasons import FORMER_REASONS, former_code

revision: str = "0006"
down_revision: str | None = "0005"
branch_labels: str | None = None
depends_on: str | None = None

TABLES = ("windows", "window_positions", "track_reports", "geometry_estimates", "trends")
REJECTED_CHUNK = "log_damaged"
CLOSED = {
    "reprofiled": "reprofiled",
    "taken out of service": "out_of_service",
    "wheelset exchanged": "wheelset_exchanged",
    "mounting corrected": "mounting_corrected",
    "rule switched off": "rule_disabled",
    "not confirmed within the on-delay": "not_confirmed",
    "cleared": "cleared",
    "all members closed": "members_closed",
}
BIN_STATUSES = {
    "estimated": "estimated",
    "too few samples": "too_few_samples",
    "a contact jump crosses the bin": "contact_jump",
    "the data cannot say": "unobservable",
}
BIN_COLUMNS = (
    "rolling_radius_sum_status",
    "rolling_radius_difference_status",
    "contact_angle_sum_status",
    "contact_angle_difference_status",
)


def upgrade() -> None:
    for table in (*TABLES, "chunks"):
        op.add_column(table, sa.Column("reason_code", sa.String(length=64), nullable=True))
        _fill(table, "reason", "reason_code", FORMER_REASONS)
    op.execute(f"UPDATE chunks SET reason_code = '{REJECTED_CHUNK}' WHERE state = 'rejected'")  # noqa: S608 - a constant
    op.add_column("alerts", sa.Column("close_code", sa.String(length=64), nullable=True))
    _fill("alerts", "close_reason", "close_code", list(CLOSED.items()))
    _fill_events()
    _fill_reports()
    _rename_bin_statuses(BIN_STATUSES)


def downgrade() -> None:
    _rename_bin_statuses({new: old for old, new in BIN_STATUSES.items()})
    op.drop_column("alerts", "close_code")
    for table in (*TABLES, "chunks"):
        op.drop_column(table, "reason_code")


def _fill(table: str, sentence: str, code: str, patterns: Sequence[tuple[str, str]]) -> None:
    """Give every row with a sentence its code, in one statement."""
    rows = sa.table(table, sa.column(sentence, sa.Text()), sa.column(code, sa.String(64)))
    written = rows.c[sentence]
    chosen = sa.case(*((written.like(pattern), found) for pattern, found in patterns), else_="other")
    op.get_bind().execute(sa.update(rows).where(written.is_not(None), written != "").values({code: chosen}))


def _fill_events() -> None:
    """Give the close reasons inside the alerts of the feed their codes."""
    connection = op.get_bind()
    events = sa.table("alert_events", sa.column("sequence", sa.BigInteger()), sa.column("alert", sa.JSON()))
    for sequence, alert in connection.execute(sa.select(events.c.sequence, events.c.alert)).all():
        if alert["close_reason"] is not None:
            closed = {**alert, "close_code": CLOSED.get(alert["close_reason"], "other")}
            connection.execute(sa.update(events).where(events.c.sequence == sequence).values(alert=closed))


def _fill_reports() -> None:
    """Give the reasons inside the reports of alignment runs their codes."""
    connection = op.get_bind()
    reports = sa.table("track_reports", sa.column("report_id", sa.BigInteger()), sa.column("report", sa.JSON()))
    for report_id, report in connection.execute(sa.select(reports.c.report_id, reports.c.report)).all():
        filled = sa.update(reports).where(reports.c.report_id == report_id).values(report=_with_codes(report))
        connection.execute(filled)


def _with_codes(report: Mapping[str, Any]) -> dict[str, Any]:
    counts: dict[str, int] = {}
    for sentence, count in report.get("refused_windows", {}).items():
        code = former_code(sentence) or "other"
        counts[code] = counts.get(code, 0) + count
    journeys = [{**one, "reason_code": former_code(one.get("reason") or "")} for one in report.get("journeys", ())]
    return {
        **report,
        "journeys": journeys,
        "recording_code": former_code(report.get("recording") or ""),
        "refused_windows_by_code": counts,
    }


def _rename_bin_statuses(names: Mapping[str, str]) -> None:
    """Rename the statuses of bins, and let the checks know the new names."""
    connection = op.get_bind()
    checks = {column: (_known(column, list(names)), _known(column, list(names.values()))) for column in BIN_COLUMNS}
    if connection.dialect.name == "sqlite":
        _replace_checks(connection, list(checks.values()))
    else:
        for column in BIN_COLUMNS:
            op.drop_constraint(op.f(f"ck_wheelset_bins_{column}_known"), "wheelset_bins", type_="check")
    bins = sa.table("wheelset_bins", *(sa.column(column, sa.String(40)) for column in BIN_COLUMNS))
    connection.execute(sa.update(bins).values({column: sa.case(names, value=bins.c[column]) for column in BIN_COLUMNS}))
    if connection.dialect.name != "sqlite":
        for column, (_, after) in checks.items():
            op.create_check_constraint(op.f(f"ck_wheelset_bins_{column}_known"), "wheelset_bins", after)


def _known(column: str, values: Sequence[str]) -> str:
    return f"{column} IN ({', '.join(repr(value) for value in values)})"


def _replace_checks(connection: sa.Connection, checks: Sequence[tuple[str, str]]) -> None:
    """Change checks in SQLite, which cannot alter them; its manual allows this where the format stays."""
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    replaced = "UPDATE sqlite_schema SET sql = replace(sql, :old, :new) WHERE type = 'table' AND name = 'wheelset_bins'"
    for old, new in checks:
        connection.execute(sa.text(replaced), {"old": old, "new": new})
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")
