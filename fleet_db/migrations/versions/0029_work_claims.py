"""Claims on work, with leases."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0029"
down_revision: str | None = "0028"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Add the tables of leases and claims."""
    op.create_table(
        "work_leases",
        sa.Column("lease_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("holder", sa.Text(), nullable=False),
        sa.Column("owner", sa.BigInteger(), nullable=True),
        sa.Column("length_ns", sa.BigInteger(), nullable=False),
        sa.Column("until_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("length_ns > 0", name=op.f("ck_work_leases_length_positive")),
        sa.PrimaryKeyConstraint("lease_id", name=op.f("pk_work_leases")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_work_leases_until_ns"), "work_leases", ["until_ns"])
    op.create_table(
        "work_claims",
        sa.Column("stage", sa.String(64), nullable=False),
        sa.Column("key", sa.String(128), nullable=False),
        sa.Column("lease_id", sa.BigInteger(), nullable=True),
        sa.Column("attempts", sa.BigInteger(), nullable=False),
        sa.Column("begun_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("attempts >= 1", name=op.f("ck_work_claims_begun")),
        sa.ForeignKeyConstraint(
            ["lease_id"],
            ["work_leases.lease_id"],
            name=op.f("fk_work_claims_lease_id_work_leases"),
            ondelete="SET NULL",
        ),
        sa.PrimaryKeyConstraint("stage", "key", name=op.f("pk_work_claims")),
    )
    op.create_index(op.f("ix_work_claims_lease_id"), "work_claims", ["lease_id"])


def downgrade() -> None:
    """Forget who works on what."""
    op.drop_table("work_claims")
    op.drop_table("work_leases")
