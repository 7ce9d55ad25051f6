"""Who sent a recording; an index of those that wait for a worker; how far the raw files have been read again."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0033"
down_revision: str | None = "0032"
branch_labels: str | None = None
depends_on: str | None = None

UNDECODED = sa.text("reason_code = 'waits_for_decoding'")
INDEX = "ix_chunks_undecoded"


def upgrade() -> None:
    """Add the column, the index and the table."""
    op.add_column("chunks", sa.Column("sender", sa.Text(), nullable=True))
    columns = ["recorded_ns", "digest", "size_bytes"]
    op.create_index(INDEX, "chunks", columns, sqlite_where=UNDECODED, postgresql_where=UNDECODED)
    op.create_table(
        "raw_scrubs",
        sa.Column("scrub_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("started_ns", sa.BigInteger(), nullable=False),
        sa.Column("finished_ns", sa.BigInteger(), nullable=True),
        sa.Column("after_digest", sa.String(64), nullable=False),
        sa.Column("files", sa.BigInteger(), nullable=False),
        sa.Column("file_bytes", sa.BigInteger(), nullable=False),
        sa.Column("faults", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("scrub_id", name=op.f("pk_raw_scrubs")),
    )


def downgrade() -> None:
    """Remove them; recordings that wait for a worker are decoded by the next ingest."""
    op.drop_table("raw_scrubs")
    op.drop_index(INDEX, "chunks")
    chunks = sa.table("chunks", sa.column("reason"), sa.column("reason_code"))
    waiting = chunks.c.reason_code == "waits_for_decoding"
    op.execute(chunks.update().where(waiting).values(reason=None, reason_code=None))
    op.drop_column("chunks", "sender")
