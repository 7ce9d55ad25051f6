"""Which version the windows of an epoch are estimated on, and vehicles whose windows are estimated on a newer one."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0034"
down_revision: str | None = "0033"
branch_labels: str | None = None
depends_on: str | None = None

EPOCHS = "track_epochs"


def upgrade() -> None:
    """Add the column, so far the version of the epoch itself, and the table."""
    op.add_column(EPOCHS, sa.Column("estimated_on", sa.Integer(), nullable=True))
    op.execute("UPDATE track_epochs SET estimated_on = version")
    op.create_table(
        "track_epoch_vehicles",
        sa.Column("section", sa.String(64), nullable=False),
        sa.Column("vehicle", sa.String(64), nullable=False),
        sa.Column("epoch", sa.Integer(), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("stiffness_ratio", sa.Double(), nullable=False),
        sa.ForeignKeyConstraint(
            ["section", "epoch"],
            ["track_epochs.section", "track_epochs.number"],
            name=op.f("fk_track_epoch_vehicles_section_epoch_track_epochs"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("section", "vehicle", "epoch", name=op.f("pk_track_epoch_vehicles")),
    )


def downgrade() -> None:
    """Remove them."""
    op.drop_table("track_epoch_vehicles")
    op.drop_column(EPOCHS, "estimated_on")
