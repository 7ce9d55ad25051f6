"""Wear signatures of windows, and what is concluded from them."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0042"
down_revision: str | None = "0041"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Add both tables."""
    op.create_table(
        "wear_signatures",
        sa.Column("wheelset", sa.String(64), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("vehicle", sa.String(64), nullable=False),
        sa.Column("section", sa.String(64), nullable=True),
        sa.Column("vehicle_class", sa.String(64), nullable=True),
        sa.Column("speed_band_m_s", sa.Integer(), nullable=True),
        sa.Column("window_digest", sa.String(64), nullable=False),
        sa.Column("assumed", sa.String(64), nullable=False),
        sa.Column("places", sa.BigInteger(), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("reason_code", sa.String(64), nullable=True),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint("places >= 0", name=op.f("ck_wear_signatures_places_counted")),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_wear_signatures_wheelset_wheelsets")),
        sa.ForeignKeyConstraint(["vehicle"], ["vehicles.code"], name=op.f("fk_wear_signatures_vehicle_vehicles")),
        sa.ForeignKeyConstraint(
            ["section"], ["track_sections.code"], name=op.f("fk_wear_signatures_section_track_sections")
        ),
        sa.PrimaryKeyConstraint("wheelset", "start_ns", name=op.f("pk_wear_signatures")),
    )
    op.create_index(
        "ix_wear_signatures_section_vehicle_class_speed_band_m_s",
        "wear_signatures",
        ["section", "vehicle_class", "speed_band_m_s"],
    )
    op.create_table(
        "signature_answers",
        sa.Column("wheelset", sa.String(64), nullable=False),
        sa.Column("baseline", sa.Integer(), nullable=False),
        sa.Column("status", sa.String(16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("reason_code", sa.String(64), nullable=True),
        sa.Column("equivalent_conicity", sa.Double(), nullable=True),
        sa.Column("equivalent_conicity_std", sa.Double(), nullable=True),
        sa.Column("disagrees", sa.Boolean(), nullable=True),
        sa.Column("input_digest", sa.String(64), nullable=False),
        sa.Column("code_version", sa.Text(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint(
            "status IN ('unestimated', 'estimated', 'invalid', 'model_mismatch')",
            name=op.f("ck_signature_answers_status_known"),
        ),
        sa.CheckConstraint("baseline >= 0", name=op.f("ck_signature_answers_baseline_counted")),
        sa.ForeignKeyConstraint(
            ["wheelset"], ["wheelsets.serial"], name=op.f("fk_signature_answers_wheelset_wheelsets")
        ),
        sa.PrimaryKeyConstraint("wheelset", name=op.f("pk_signature_answers")),
    )


def downgrade() -> None:
    """Remove them."""
    op.drop_table("signature_answers")
    op.drop_table("wear_signatures")
