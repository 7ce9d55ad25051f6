"""Hunting of windows; what the passes of a section showed of the suspension of a vehicle."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0009"
down_revision: str | None = "0008"
branch_labels: str | None = None
depends_on: str | None = None

HUNTING = ("hunting_share", "hunting_hz", "hunting_amplitude_m")


def upgrade() -> None:
    for name in HUNTING:
        op.add_column("windows", sa.Column(name, sa.Double(), nullable=True))
    op.create_table(
        "suspension_findings",
        sa.Column("vehicle", sa.String(length=64), nullable=False),
        sa.Column("section", sa.String(length=64), nullable=False),
        sa.Column("to_ns", sa.BigInteger(), nullable=False),
        sa.Column("from_ns", sa.BigInteger(), nullable=False),
        sa.Column("ratio", sa.Double(), nullable=False),
        sa.Column("ratio_std", sa.Double(), nullable=False),
        sa.Column("assumed_m", sa.Double(), nullable=False),
        sa.Column("code_version", sa.Text(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("ratio > 0", name=op.f("ck_suspension_findings_ratio_positive")),
        sa.CheckConstraint("ratio_std > 0", name=op.f("ck_suspension_findings_ratio_std_positive")),
        sa.CheckConstraint("assumed_m > 0", name=op.f("ck_suspension_findings_assumed_positive")),
        sa.CheckConstraint("from_ns <= to_ns", name=op.f("ck_suspension_findings_from_before_to")),
        sa.ForeignKeyConstraint(
            ["section"], ["track_sections.code"], name=op.f("fk_suspension_findings_section_track_sections")
        ),
        sa.ForeignKeyConstraint(["vehicle"], ["vehicles.code"], name=op.f("fk_suspension_findings_vehicle_vehicles")),
        sa.PrimaryKeyConstraint("vehicle", "section", "to_ns", name=op.f("pk_suspension_findings")),
    )


def downgrade() -> None:
    op.drop_table("suspension_findings")
    for name in HUNTING:
        op.drop_column("windows", name)
