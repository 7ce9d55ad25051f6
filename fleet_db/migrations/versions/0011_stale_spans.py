"""Spans of a vehicle's clock whose windows are to be assembled again, and what was decided on the registry."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0011"
down_revision: str | None = "0010"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    op.create_table(
        "stale_spans",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("vehicle", sa.String(length=64), nullable=False),
        sa.Column("from_ns", sa.BigInteger(), nullable=False),
        sa.Column("to_ns", sa.BigInteger(), nullable=False),
        sa.Column("cause", sa.Text(), nullable=False),
        sa.CheckConstraint("to_ns > from_ns", name=op.f("ck_stale_spans_ends_after_start")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_stale_spans")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_stale_spans_vehicle_from_ns"), "stale_spans", ["vehicle", "from_ns"], unique=False)
    op.create_table(
        "registry_events",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("subject", sa.String(length=64), nullable=False),
        sa.Column("at_ns", sa.BigInteger(), nullable=True),
        sa.Column("action", sa.String(length=16), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("record", sa.JSON(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=True),
        sa.CheckConstraint(
            "kind IN ('mounting', 'reprofiling', 'measurement', 'wheelset', 'section')",
            name=op.f("ck_registry_events_kind_known"),
        ),
        sa.CheckConstraint("action IN ('changed', 'voided', 'restored')", name=op.f("ck_registry_events_action_known")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_registry_events")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_registry_events_subject_kind"), "registry_events", ["subject", "kind"], unique=False)


def downgrade() -> None:
    op.drop_index(op.f("ix_registry_events_subject_kind"), table_name="registry_events")
    op.drop_table("registry_events")
    op.drop_index(op.f("ix_stale_spans_vehicle_from_ns"), table_name="stale_spans")
    op.drop_table("stale_spans")
