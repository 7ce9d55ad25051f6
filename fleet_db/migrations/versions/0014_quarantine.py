"""What failed by itself and is kept apart; recordings set aside by hand and the record of it; the raw store's mark."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0014"
down_revision: str | None = "0013"
branch_labels: str | None = None
depends_on: str | None = None

BEFORE = "state IN ('stored', 'decoded', 'rejected')"
AFTER = "state IN ('stored', 'decoded', 'rejected', 'set_aside')"
STATES = "('stored', 'decoded', 'rejected', 'set_aside')"


def upgrade() -> None:
    _replace(BEFORE, AFTER)
    _create_quarantine()
    op.create_table(
        "recording_changes",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("action", sa.String(length=16), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("why", sa.Text(), nullable=False),
        sa.Column("vehicle_before", sa.String(length=64), nullable=False),
        sa.Column("state_before", sa.String(length=16), nullable=False),
        sa.Column("vehicle_after", sa.String(length=64), nullable=False),
        sa.Column("state_after", sa.String(length=16), nullable=False),
        sa.CheckConstraint(
            "action IN ('retry', 'set_aside', 'restore', 'move')", name=op.f("ck_recording_changes_action_known")
        ),
        sa.CheckConstraint(f"state_before IN {STATES}", name=op.f("ck_recording_changes_state_before_known")),
        sa.CheckConstraint(f"state_after IN {STATES}", name=op.f("ck_recording_changes_state_after_known")),
        sa.PrimaryKeyConstraint("id", name=op.f("pk_recording_changes")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_recording_changes_digest_id"), "recording_changes", ["digest", "id"], unique=False)
    op.create_table(
        "raw_marks",
        sa.Column("mark", sa.String(length=64), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("mark", name=op.f("pk_raw_marks")),
    )


def _create_quarantine() -> None:
    op.create_table(
        "quarantine",
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("key", sa.String(length=128), nullable=False),
        sa.Column("stage", sa.String(length=64), nullable=False),
        sa.Column("code", sa.String(length=64), nullable=False),
        sa.Column("error", sa.Text(), nullable=False),
        sa.Column("inputs", sa.Text(), nullable=False),
        sa.Column("first_ns", sa.BigInteger(), nullable=False),
        sa.Column("last_ns", sa.BigInteger(), nullable=False),
        sa.Column("due_ns", sa.BigInteger(), nullable=False),
        sa.Column("attempts", sa.BigInteger(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.CheckConstraint(
            "kind IN ('recording', 'window', 'wheelset', 'section', 'vehicle', 'fleet')",
            name=op.f("ck_quarantine_kind_known"),
        ),
        sa.CheckConstraint("state IN ('held', 'resolved')", name=op.f("ck_quarantine_state_known")),
        sa.CheckConstraint("attempts >= 1", name=op.f("ck_quarantine_tried")),
        sa.PrimaryKeyConstraint("kind", "key", "stage", name=op.f("pk_quarantine")),
    )
    op.create_index(op.f("ix_quarantine_stage_state"), "quarantine", ["stage", "state"], unique=False)
    op.create_index(op.f("ix_quarantine_state_last_ns"), "quarantine", ["state", "last_ns"], unique=False)


def downgrade() -> None:
    op.drop_table("raw_marks")
    op.drop_index(op.f("ix_recording_changes_digest_id"), table_name="recording_changes")
    op.drop_table("recording_changes")
    op.drop_index(op.f("ix_quarantine_state_last_ns"), table_name="quarantine")
    op.drop_index(op.f("ix_quarantine_stage_state"), table_name="quarantine")
    op.drop_table("quarantine")
    op.execute("UPDATE chunks SET state = 'rejected' WHERE state = 'set_aside'")
    _replace(AFTER, BEFORE)


def _replace(old: str, new: str) -> None:
    """Put one check of the states of recordings in the place of another."""
    connection = op.get_bind()
    if connection.dialect.name != "sqlite":
        op.drop_constraint(op.f("ck_chunks_state_known"), "chunks", type_="check")
        op.create_check_constraint(op.f("ck_chunks_state_known"), "chunks", new)
        return
    # SQLite cannot alter a check; its manual of ALTER TABLE allows changing the text where the format stays
    version = connection.exec_driver_sql("PRAGMA schema_version").scalar_one()
    connection.exec_driver_sql("PRAGMA writable_schema = ON")
    connection.execute(
        sa.text("UPDATE sqlite_schema SET sql = replace(sql, :old, :new) WHERE type = 'table' AND name = 'chunks'"),
        {"old": old, "new": new},
    )
    connection.exec_driver_sql(f"PRAGMA schema_version = {version + 1}")
    connection.exec_driver_sql("PRAGMA writable_schema = OFF")
