"""Where versions of an alignment came from, what the runs that made them found, and where windows were."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0003"
down_revision: str | None = "0002"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    op.create_table(
        "track_versions",
        sa.Column("section", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("source", sa.String(length=16), nullable=False),
        sa.Column("same_since", sa.Integer(), nullable=False),
        sa.Column("cut_off_m", sa.Double(), nullable=True),
        sa.Column("scale_std", sa.Double(), nullable=False),
        sa.Column("gauge_known", sa.Boolean(), nullable=False),
        sa.Column("alignment_std_m", sa.Double(), nullable=True),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("source IN ('recorded', 'fleet')", name=op.f("ck_track_versions_source_known")),
        sa.CheckConstraint("same_since <= version", name=op.f("ck_track_versions_same_since_before")),
        sa.ForeignKeyConstraint(
            ["section", "version"],
            ["track_alignments.section", "track_alignments.version"],
            name=op.f("fk_track_versions_section_version_track_alignments"),
        ),
        sa.PrimaryKeyConstraint("section", "version", name=op.f("pk_track_versions")),
    )
    op.create_table(
        "track_reports",
        sa.Column("report_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("section", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=True),
        sa.Column("made", sa.Boolean(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("windows", sa.BigInteger(), nullable=False),
        sa.Column("input_digest", sa.String(length=64), nullable=False),
        sa.Column("code_version", sa.Text(), nullable=False),
        sa.Column("report", sa.JSON(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint(
            "status IN ('unestimated', 'estimated', 'invalid')", name=op.f("ck_track_reports_status_known")
        ),
        sa.ForeignKeyConstraint(
            ["section"], ["track_sections.code"], name=op.f("fk_track_reports_section_track_sections")
        ),
        sa.PrimaryKeyConstraint("report_id", name=op.f("pk_track_reports")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_track_reports_section_report_id"), "track_reports", ["section", "report_id"], unique=False)
    op.create_table(
        "window_positions",
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("content_digest", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=True),
        sa.Column("offset_m", sa.Double(), nullable=False),
        sa.Column("scale", sa.Double(), nullable=False),
        sa.Column("middle_m", sa.Double(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(
            ["wheelset", "start_ns"],
            ["windows.wheelset", "windows.start_ns"],
            name=op.f("fk_window_positions_wheelset_start_ns_windows"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("wheelset", "start_ns", name=op.f("pk_window_positions")),
    )


def downgrade() -> None:
    op.drop_table("window_positions")
    op.drop_index(op.f("ix_track_reports_section_report_id"), table_name="track_reports")
    op.drop_table("track_reports")
    op.drop_table("track_versions")
