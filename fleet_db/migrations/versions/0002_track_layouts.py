"""Versions of the horizontal layout of track sections."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0002"
down_revision: str | None = "0001"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    op.create_table(
        "track_layouts",
        sa.Column("section", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("points", sa.BigInteger(), nullable=False),
        sa.Column("content_digest", sa.String(length=64), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint("version > 0", name=op.f("ck_track_layouts_version_positive")),
        sa.ForeignKeyConstraint(
            ["section"], ["track_sections.code"], name=op.f("fk_track_layouts_section_track_sections")
        ),
        sa.PrimaryKeyConstraint("section", "version", name=op.f("pk_track_layouts")),
    )


def downgrade() -> None:
    op.drop_table("track_layouts")
