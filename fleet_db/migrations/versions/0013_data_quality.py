"""What is implausible in recordings, and its alerts."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0013"
down_revision: str | None = "0012"
branch_labels: str | None = None
depends_on: str | None = None


TABLES = ("geometry_estimates", "trends")


def upgrade() -> None:
    """Add what is known of the mileage of windows, and indexes by recorded time."""
    op.add_column("windows", sa.Column("odometer_excess_m", sa.Double(), server_default=sa.text("0"), nullable=False))
    op.add_column("windows", sa.Column("implausible", sa.Text(), nullable=True))
    op.add_column("windows", sa.Column("implausible_code", sa.String(64), nullable=True))
    op.add_column("windows", sa.Column("judged", sa.Boolean(), server_default=sa.false(), nullable=False))
    op.create_index(
        "ix_windows_unjudged",
        "windows",
        ["wheelset"],
        sqlite_where=sa.text("judged = 0"),
        postgresql_where=sa.text("NOT judged"),
    )
    for table in TABLES:
        op.create_index(op.f(f"ix_{table}_recorded_ns"), table, ["recorded_ns"])


def downgrade() -> None:
    """Remove them."""
    for table in TABLES:
        op.drop_index(op.f(f"ix_{table}_recorded_ns"), table)
    op.drop_index("ix_windows_unjudged", "windows")
    for column in ("judged", "implausible_code", "implausible", "odometer_excess_m"):
        op.drop_column("windows", column)
