"""What is implausible in recordings, and its alerts."""

from __future__ import annotations

from alembic import op

revision: str = "0013"
down_revision: str | None = "0012"
branch_labels: str | None = None
depends_on: str | None = None


TABLES = ("geometry_estimates", "trends")


def upgrade() -> None:
    """Add the indexes by which results are found that were stored while our clock was ahead."""
    for table in TABLES:
        op.create_index(op.f(f"ix_{table}_recorded_ns"), table, ["recorded_ns"])


def downgrade() -> None:
    """Remove them."""
    for table in TABLES:
        op.drop_index(op.f(f"ix_{table}_recorded_ns"), table)
