"""What was purged, when and why; recordings whose raw file was purged."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0017"
down_revision: str | None = "0016"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    op.create_table(
        "purges",
        sa.Column("purge_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("before_ns", sa.BigInteger(), nullable=False),
        sa.Column("items", sa.BigInteger(), nullable=False),
        sa.Column("item_bytes", sa.BigInteger(), nullable=False),
        sa.Column("purged_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("items >= 0", name=op.f("ck_purges_items_counted")),
        sa.PrimaryKeyConstraint("purge_id", name=op.f("pk_purges")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_purges_kind_before_ns"), "purges", ["kind", "before_ns"], unique=False)
    op.add_column("chunks", sa.Column("purged_ns", sa.BigInteger(), nullable=True))


def downgrade() -> None:
    op.drop_column("chunks", "purged_ns")
    op.drop_index(op.f("ix_purges_kind_before_ns"), table_name="purges")
    op.drop_table("purges")
