"""Which database a cursor of the feed belongs to."""

from __future__ import annotations

import time
import uuid

import sqlalchemy as sa
from alembic import op

revision: str = "0016"
down_revision: str | None = "0015"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Give the database its identity; all events so far are of its first branch."""
    table = op.create_table(
        "feed_branches",
        sa.Column("branch_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("identity", sa.String(length=32), nullable=False),
        sa.Column("after_sequence", sa.BigInteger(), nullable=False),
        sa.Column("began_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("branch_id", name=op.f("pk_feed_branches")),
        sa.UniqueConstraint("identity", name=op.f("uq_feed_branches_identity")),
        sqlite_autoincrement=True,
    )
    op.bulk_insert(table, [{"identity": uuid.uuid4().hex, "after_sequence": 0, "began_ns": time.time_ns()}])


def downgrade() -> None:
    """Forget the identity; cursors of later are then unknown."""
    op.drop_table("feed_branches")
