"""What windows say of their rolling radius is summed again: the terms of the equation are others."""

from __future__ import annotations

from alembic import op

revision: str = "0050"
down_revision: str | None = "0049"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Forget the sums; they are made again from the samples."""
    op.execute("DELETE FROM rolling_sums")


def downgrade() -> None:
    """Forget them likewise."""
    op.execute("DELETE FROM rolling_sums")
