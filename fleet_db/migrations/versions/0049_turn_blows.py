"""Blows once a turn of the wheel, of windows."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0049"
down_revision: str | None = "0044"
branch_labels: str | None = None
depends_on: str | None = None

NUMBERS = ("blows_share", "blows_m_s2", "blows_turn_m")


def upgrade() -> None:
    """Add the columns; they are null in windows that were not looked at for blows."""
    for name in NUMBERS:
        op.add_column("windows", sa.Column(name, sa.Double(), nullable=True))
    op.add_column("windows", sa.Column("blows_side", sa.Integer(), nullable=True))


def downgrade() -> None:
    """Remove them."""
    for name in (*NUMBERS, "blows_side"):
        op.drop_column("windows", name)
