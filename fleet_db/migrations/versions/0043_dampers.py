"""Lateral dampers of running gears: what windows say, and what they say together."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0043"
down_revision: str | None = "0042"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Add both tables."""
    op.create_table(
        "window_dampers",
        sa.Column("vehicle", sa.String(64), nullable=False),
        sa.Column("first_axle", sa.Integer(), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("wheelset", sa.String(64), nullable=False),
        sa.Column("content_digest", sa.String(64), nullable=False),
        sa.Column("odometer_km", sa.Double(), nullable=False),
        sa.Column("reason_code", sa.String(64), nullable=True),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint("first_axle > 0", name=op.f("ck_window_dampers_first_axle_positive")),
        sa.ForeignKeyConstraint(["vehicle"], ["vehicles.code"], name=op.f("fk_window_dampers_vehicle_vehicles")),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_window_dampers_wheelset_wheelsets")),
        sa.PrimaryKeyConstraint("vehicle", "first_axle", "start_ns", name=op.f("pk_window_dampers")),
    )
    op.create_table(
        "gear_dampers",
        sa.Column("vehicle", sa.String(64), nullable=False),
        sa.Column("first_axle", sa.Integer(), nullable=False),
        sa.Column("from_ns", sa.BigInteger(), nullable=False),
        sa.Column("to_ns", sa.BigInteger(), nullable=False),
        sa.Column("windows", sa.BigInteger(), nullable=False),
        sa.Column("share", sa.Double(), nullable=True),
        sa.Column("weak", sa.Boolean(), nullable=True),
        sa.Column("reason_code", sa.String(64), nullable=True),
        sa.Column("code_version", sa.Text(), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("first_axle > 0", name=op.f("ck_gear_dampers_first_axle_positive")),
        sa.CheckConstraint("from_ns <= to_ns", name=op.f("ck_gear_dampers_from_before_to")),
        sa.ForeignKeyConstraint(["vehicle"], ["vehicles.code"], name=op.f("fk_gear_dampers_vehicle_vehicles")),
        sa.PrimaryKeyConstraint("vehicle", "first_axle", name=op.f("pk_gear_dampers")),
    )


def downgrade() -> None:
    """Remove them."""
    op.drop_table("gear_dampers")
    op.drop_table("window_dampers")
