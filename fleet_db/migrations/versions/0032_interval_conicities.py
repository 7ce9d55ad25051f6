"""The conicities of a geometry beside it: a trend reads them without unpacking the bins."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0032"
down_revision: str | None = "0029"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Add the column; geometries of before are unpacked where it is empty."""
    op.add_column("geometry_estimates", sa.Column("conicities", sa.Text(), nullable=True))


def downgrade() -> None:
    """Remove it; all of it is in the geometry itself."""
    op.drop_column("geometry_estimates", "conicities")
