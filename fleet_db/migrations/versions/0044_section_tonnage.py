"""Traffic of track sections."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0044"
down_revision: str | None = "0043"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Add the column; it is null where the registry says nothing."""
    op.add_column("track_sections", sa.Column("tonnage_mgt_per_year", sa.Double(), nullable=True))


def downgrade() -> None:
    """Remove it."""
    op.drop_column("track_sections", "tonnage_mgt_per_year")
