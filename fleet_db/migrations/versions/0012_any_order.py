"""What makes the result independent of the order of arrival: epochs of sections in vehicle time."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0012"
down_revision: str | None = "0011"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    op.create_table(
        "track_epochs",
        sa.Column("section", sa.String(length=64), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("before", sa.Text(), nullable=False),
        sa.Column("input_digest", sa.String(length=64), nullable=False),
        sa.Column("horizon_ns", sa.BigInteger(), nullable=False),
        sa.Column("windows", sa.BigInteger(), nullable=False),
        sa.Column("waits", sa.Boolean(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=True),
        sa.Column("same_since", sa.Integer(), nullable=True),
        sa.Column("survey", sa.Text(), nullable=False),
        sa.Column("survey_code", sa.String(length=64), nullable=True),
        sa.Column("report", sa.BigInteger(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("number > 0", name=op.f("ck_track_epochs_number_positive")),
        sa.ForeignKeyConstraint(
            ["section"], ["track_sections.code"], name=op.f("fk_track_epochs_section_track_sections")
        ),
        sa.PrimaryKeyConstraint("section", "number", name=op.f("pk_track_epochs")),
    )
    op.create_table(
        "track_epoch_windows",
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("section", sa.String(length=64), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("vehicle", sa.String(length=64), nullable=False),
        sa.Column("content_digest", sa.String(length=64), nullable=False),
        sa.Column("mileage_km", sa.Double(), nullable=False),
        sa.Column("context", sa.String(length=64), nullable=False),
        sa.Column("assumed", sa.String(length=64), nullable=False),
        sa.Column("placed", sa.Boolean(), nullable=False),
        sa.Column("estimated_version", sa.Integer(), nullable=True),
        sa.ForeignKeyConstraint(
            ["section", "epoch"],
            ["track_epochs.section", "track_epochs.number"],
            name=op.f("fk_track_epoch_windows_section_epoch_track_epochs"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("wheelset", "start_ns", name=op.f("pk_track_epoch_windows")),
    )
    op.create_index(op.f("ix_track_epoch_windows_section_epoch"), "track_epoch_windows", ["section", "epoch"])
    op.create_index(op.f("ix_windows_track_section_start_ns"), "windows", ["track_section", "start_ns"])
    op.add_column("track_versions", sa.Column("superseded_ns", sa.BigInteger(), nullable=True))
    op.add_column("window_bin_tables", sa.Column("content_digest", sa.String(length=64), nullable=True))
    op.add_column("suspension_findings", sa.Column("epoch", sa.Integer(), nullable=True))


def downgrade() -> None:
    op.drop_column("suspension_findings", "epoch")
    op.drop_column("window_bin_tables", "content_digest")
    op.drop_column("track_versions", "superseded_ns")
    op.drop_index(op.f("ix_windows_track_section_start_ns"), table_name="windows")
    op.drop_index(op.f("ix_track_epoch_windows_section_epoch"), table_name="track_epoch_windows")
    op.drop_table("track_epoch_windows")
    op.drop_table("track_epochs")
