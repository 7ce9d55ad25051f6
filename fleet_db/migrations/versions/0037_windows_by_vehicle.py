"""Index windows by vehicle: what a recording changes is found without looking at all windows."""

from __future__ import annotations

from alembic import op

revision: str = "0037"
down_revision: str | None = "0036"
branch_labels: str | None = None
depends_on: str | None = None

INDEX = "ix_windows_vehicle_start_ns"


def upgrade() -> None:
    """Add the index."""
    op.create_index(INDEX, "windows", ["vehicle", "start_ns"])


def downgrade() -> None:
    """Remove the index."""
    op.drop_index(INDEX, "windows")
