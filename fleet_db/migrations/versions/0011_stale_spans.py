"""Spans of a vehicle's clock whose windows are to be assembled again."""

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


def downgrade() -> None:
    op.drop_index(op.f("ix_stale_spans_vehicle_from_ns"), table_name="stale_spans")
    op.drop_table("stale_spans")
