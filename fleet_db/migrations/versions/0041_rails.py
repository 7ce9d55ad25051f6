"""Wheels and rails apart: conicities of wheelsets by section, and what was found of rails and of wheels."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0041"
down_revision: str | None = "0040"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Add the tables; the next run of ``refresh_rails`` fills them from the bin tables that are there."""
    op.create_table(
        "rail_cells",
        sa.Column("wheelset", sa.String(64), nullable=False),
        sa.Column("baseline", sa.Integer(), nullable=False),
        sa.Column("mileage_interval", sa.Integer(), nullable=False),
        sa.Column("section", sa.String(64), nullable=False),
        sa.Column("period", sa.Integer(), nullable=False),
        sa.Column("digest", sa.String(64), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.CheckConstraint("baseline >= 0", name=op.f("ck_rail_cells_baseline_counted")),
        sa.CheckConstraint("period >= 0", name=op.f("ck_rail_cells_period_counted")),
        sa.ForeignKeyConstraint(
            ["section"], ["track_sections.code"], name=op.f("fk_rail_cells_section_track_sections")
        ),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_rail_cells_wheelset_wheelsets")),
        sa.PrimaryKeyConstraint(
            "wheelset", "baseline", "mileage_interval", "section", "period", name=op.f("pk_rail_cells")
        ),
    )
    _found("section_rails", "section", "track_sections", "code")
    _found("wheelset_rails", "wheelset", "wheelsets", "serial")


def _found(table: str, key: str, of_table: str, of_column: str) -> None:
    op.create_table(
        table,
        sa.Column(key, sa.String(64), nullable=False),
        sa.Column("input_digest", sa.String(64), nullable=False),
        sa.Column("code_version", sa.Text(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.Column("document", sa.JSON(), nullable=False),
        sa.ForeignKeyConstraint([key], [f"{of_table}.{of_column}"], name=op.f(f"fk_{table}_{key}_{of_table}")),
        sa.PrimaryKeyConstraint(key, name=op.f(f"pk_{table}")),
    )


def downgrade() -> None:
    """Remove them."""
    for table in ("wheelset_rails", "section_rails", "rail_cells"):
        op.drop_table(table)
