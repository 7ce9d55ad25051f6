"""Creep forces and friction, and alerts that are about a track section."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0040"
down_revision: str | None = "0039"
branch_labels: str | None = None
depends_on: str | None = None

STATUSES = "status IN ('unestimated', 'estimated', 'invalid', 'model_mismatch')"
OF_FLEET_BEFORE = "wheelset IS NULL AND closed_ns IS NULL"
OF_FLEET = "wheelset IS NULL AND track_section IS NULL AND closed_ns IS NULL"
OF_SECTION = "track_section IS NOT NULL AND closed_ns IS NULL"


def upgrade() -> None:
    """Add the tables, and the column of alerts; an open alert of a section does not stand in the way of a fleet's."""
    op.create_table(
        "window_adhesion",
        sa.Column("wheelset", sa.String(64), sa.ForeignKey("wheelsets.serial"), primary_key=True),
        sa.Column("start_ns", sa.BigInteger(), primary_key=True),
        sa.Column("vehicle", sa.String(64), sa.ForeignKey("vehicles.code"), nullable=False),
        sa.Column("track_section", sa.String(64), sa.ForeignKey("track_sections.code"), nullable=True),
        sa.Column("content_digest", sa.String(64), nullable=False),
        sa.Column("status", sa.String(16), nullable=False),
        sa.Column("reason_code", sa.String(64), nullable=True),
        sa.Column("with_sums", sa.Boolean(), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint(STATUSES, name=op.f("ck_window_adhesion_status_known")),
    )
    name = op.f("ix_window_adhesion_track_section_start_ns")
    op.create_index(name, "window_adhesion", ["track_section", "start_ns"])
    op.create_table(
        "section_adhesion",
        sa.Column("track_section", sa.String(64), sa.ForeignKey("track_sections.code"), primary_key=True),
        sa.Column("to_ns", sa.BigInteger(), primary_key=True),
        sa.Column("from_ns", sa.BigInteger(), nullable=False),
        sa.Column("windows", sa.BigInteger(), nullable=False),
        sa.Column("code_version", sa.Text(), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("from_ns <= to_ns", name=op.f("ck_section_adhesion_from_before_to")),
    )
    op.add_column("alerts", sa.Column("track_section", sa.String(64), nullable=True))
    _index_fleet_alerts(OF_FLEET)
    op.create_index(
        "uq_alerts_one_open_of_section",
        "alerts",
        ["fleet", "track_section", "kind"],
        unique=True,
        sqlite_where=sa.text(OF_SECTION),
        postgresql_where=sa.text(OF_SECTION),
    )


def downgrade() -> None:
    """Remove them; alerts of sections and their events go, which an earlier release cannot read."""
    of_section = "SELECT alert_id FROM alerts WHERE track_section IS NOT NULL"
    op.execute(f"DELETE FROM alert_events WHERE alert_id IN ({of_section})")  # noqa: S608 - a constant
    op.drop_index("uq_alerts_one_open_of_section", "alerts")
    op.execute("DELETE FROM alerts WHERE track_section IS NOT NULL")
    _index_fleet_alerts(OF_FLEET_BEFORE)
    op.drop_column("alerts", "track_section")
    op.drop_table("section_adhesion")
    op.drop_table("window_adhesion")


def _index_fleet_alerts(where: str) -> None:
    """Make the index of open alerts of fleets again."""
    name = "uq_alerts_one_open_of_fleet"
    op.drop_index(name, "alerts")
    columns, condition = ["fleet", "kind"], sa.text(where)
    op.create_index(name, "alerts", columns, unique=True, sqlite_where=condition, postgresql_where=condition)
