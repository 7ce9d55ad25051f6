"""What has happened on each track section, and what jobs have seen of it; so far they have seen nothing."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0038"
down_revision: str | None = "0037"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Add both tables, with every section that windows are on, whether it is still on file or not."""
    op.create_table(
        "section_changes",
        sa.Column("section", sa.String(64), nullable=False),
        sa.Column("touched", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("section", name=op.f("pk_section_changes")),
    )
    op.execute(
        "INSERT INTO section_changes (section, touched) SELECT DISTINCT track_section, 1 FROM windows"
        " WHERE track_section IS NOT NULL"
    )
    op.create_table(
        "section_looks",
        sa.Column("stage", sa.String(32), nullable=False),
        sa.Column("section", sa.String(64), nullable=False),
        sa.Column("inputs", sa.String(64), nullable=False),
        sa.Column("touched", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("stage", "section", name=op.f("pk_section_looks")),
    )


def downgrade() -> None:
    """Remove them."""
    op.drop_table("section_looks")
    op.drop_table("section_changes")
