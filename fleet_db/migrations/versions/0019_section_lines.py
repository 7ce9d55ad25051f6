"""Where sections are on the map, and how far from that vehicles were by GNSS."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0019"
down_revision: str | None = "0018"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Add the line of a section, and the distance of a window from it."""
    op.add_column("track_sections", sa.Column("line", sa.JSON(), nullable=True))
    op.add_column("windows", sa.Column("off_line_m", sa.Double(), server_default=sa.text("0"), nullable=False))


def downgrade() -> None:
    """Remove them."""
    op.drop_column("windows", "off_line_m")
    op.drop_column("track_sections", "line")
