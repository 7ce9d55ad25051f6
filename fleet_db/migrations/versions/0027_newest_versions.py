"""Indexes that lead to the newest trend and geometry of a wheelset; what jobs have seen of each wheelset."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0027"
down_revision: str | None = "0026"
branch_labels: str | None = None
depends_on: str | None = None

GEOMETRIES, TRENDS = "geometry_estimates", "trends"
BY_INTERVAL = ["wheelset", "baseline", "baseline_interval"]
BEFORE = "ix_geometry_estimates_wheelset_baseline_baseline_interval_recorded_ns"


def upgrade() -> None:
    """Let the indexes end in the number of the version, which says what is newest; add the table of looks."""
    op.create_table(
        "looks",
        sa.Column("stage", sa.String(32), nullable=False),
        sa.Column("wheelset", sa.String(64), nullable=False),
        sa.Column("inputs", sa.String(64), nullable=False),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_looks_wheelset_wheelsets")),
        sa.PrimaryKeyConstraint("stage", "wheelset", name=op.f("pk_looks")),
    )
    op.create_index(op.f("ix_trends_wheelset_trend_id"), TRENDS, ["wheelset", "trend_id"])
    op.drop_index(op.f("ix_trends_wheelset_recorded_ns"), TRENDS)
    op.create_index("ix_geometry_interval", GEOMETRIES, [*BY_INTERVAL, "geometry_id", "recorded_ns"])
    op.drop_index(op.f(BEFORE), GEOMETRIES)
    op.create_index(op.f("ix_geometry_estimates_wheelset_geometry_id"), GEOMETRIES, ["wheelset", "geometry_id"])
    current, columns = sa.text("baseline_interval IS NULL"), ["wheelset", "baseline", "geometry_id", "recorded_ns"]
    op.create_index("ix_geometry_current_baseline", GEOMETRIES, columns, sqlite_where=current, postgresql_where=current)


def downgrade() -> None:
    """Let them end in the recorded time again; every wheelset is looked at again, too."""
    op.drop_table("looks")
    op.drop_index("ix_geometry_current_baseline", GEOMETRIES)
    op.drop_index(op.f("ix_geometry_estimates_wheelset_geometry_id"), GEOMETRIES)
    op.create_index(op.f(BEFORE), GEOMETRIES, [*BY_INTERVAL, "recorded_ns"])
    op.drop_index("ix_geometry_interval", GEOMETRIES)
    op.create_index(op.f("ix_trends_wheelset_recorded_ns"), TRENDS, ["wheelset", "recorded_ns"])
    op.drop_index(op.f("ix_trends_wheelset_trend_id"), TRENDS)
