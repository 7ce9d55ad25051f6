"""Measured profiles of wheelsets."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0005"
down_revision: str | None = "0004"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    op.create_table(
        "measured_profiles",
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("at_ns", sa.BigInteger(), nullable=False),
        sa.Column("mileage_km", sa.Double(), nullable=False),
        sa.Column("std_m", sa.Double(), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint("std_m > 0", name=op.f("ck_measured_profiles_std_positive")),
        sa.ForeignKeyConstraint(
            ["wheelset"], ["wheelsets.serial"], name=op.f("fk_measured_profiles_wheelset_wheelsets")
        ),
        sa.PrimaryKeyConstraint("wheelset", "at_ns", name=op.f("pk_measured_profiles")),
    )


def downgrade() -> None:
    op.drop_table("measured_profiles")
