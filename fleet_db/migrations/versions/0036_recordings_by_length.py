"""Decoded recordings by their length, and the stamps of their recorder as columns: what overlaps is found by index."""

from __future__ import annotations

import json

import sqlalchemy as sa
from alembic import op

revision: str = "0036"
down_revision: str | None = "0035"
branch_labels: str | None = None
depends_on: str | None = None

STAMPS = ("recorder_first_ns", "recorder_last_ns")
LENGTHS = (
    ("short", "{last} - {first} <= 60000000000"),
    ("middle", "{last} - {first} > 60000000000 AND {last} - {first} <= 3600000000000"),
    ("long", "{last} - {first} > 3600000000000"),
)
CLOCKS = (("first_ns", "last_ns"), STAMPS)
FORMER = "ix_chunks_vehicle_first_ns"
READ = 1000


def upgrade() -> None:
    """Add the columns, fill them from the counts of each recording, and index them."""
    for name in STAMPS:
        op.add_column("chunks", sa.Column(name, sa.BigInteger(), nullable=True))
    _fill()
    op.drop_index(FORMER, "chunks")
    for first, last in CLOCKS:
        for name, text in LENGTHS:
            where = sa.text(f"state = 'decoded' AND {text.format(first=first, last=last)}")
            index = f"ix_chunks_{name}_{first}"
            op.create_index(index, "chunks", ["vehicle", first], sqlite_where=where, postgresql_where=where)


def _fill() -> None:
    connection = op.get_bind()
    chunks = sa.table("chunks", *(sa.column(name) for name in ("digest", "counts", *STAMPS)))
    fill = chunks.update().where(chunks.c.digest == sa.bindparam("of"))
    fill = fill.values({name: sa.bindparam(f"new_{name}") for name in STAMPS})
    after = ""
    while True:
        following = sa.select(chunks.c.digest, chunks.c.counts).where(chunks.c.digest > after)
        found = connection.execute(following.order_by(chunks.c.digest).limit(READ)).all()
        if not found:
            return
        counts = {digest: json.loads(text) if isinstance(text, str) else text for digest, text in found}
        rows = [
            {"of": digest} | {f"new_{name}": one[name] for name in STAMPS}
            for digest, one in counts.items()
            if one is not None and set(STAMPS) <= set(one)
        ]
        if rows:
            connection.execute(fill, rows)
        after = found[-1].digest


def downgrade() -> None:
    """Remove the columns: the counts of each recording have them too."""
    for first, _ in CLOCKS:
        for name, _ in LENGTHS:
            op.drop_index(f"ix_chunks_{name}_{first}", "chunks")
    op.create_index(FORMER, "chunks", ["vehicle", "first_ns"])
    for name in STAMPS:
        op.drop_column("chunks", name)
