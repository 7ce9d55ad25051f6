"""Versions of vehicle classes."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0008"
down_revision: str | None = "0007"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    op.create_table(
        "vehicle_classes",
        sa.Column("code", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("source", sa.Text(), nullable=False),
        sa.Column("arrangement", sa.String(length=32), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint(
            "arrangement IN ('single_wheelset', 'bogie')", name=op.f("ck_vehicle_classes_arrangement_known")
        ),
        sa.CheckConstraint("version > 0", name=op.f("ck_vehicle_classes_version_counted")),
        sa.PrimaryKeyConstraint("code", "version", name=op.f("pk_vehicle_classes")),
    )


def downgrade() -> None:
    op.drop_table("vehicle_classes")
