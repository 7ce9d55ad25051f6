"""Recordings whose receipt was given by a clock that was wrong."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0018"
down_revision: str | None = "0017"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    op.add_column("chunks", sa.Column("clock_checked_ns", sa.BigInteger(), nullable=True))


def downgrade() -> None:
    op.drop_column("chunks", "clock_checked_ns")
