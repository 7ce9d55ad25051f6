"""Alerts are listed by severity."""

from __future__ import annotations

from alembic import op

revision: str = "0025"
down_revision: str | None = "0024"
branch_labels: str | None = None
depends_on: str | None = None


def upgrade() -> None:
    """Add the index."""
    op.create_index(op.f("ix_alerts_severity_alert_id"), "alerts", ["severity", "alert_id"])


def downgrade() -> None:
    """Remove it."""
    op.drop_index(op.f("ix_alerts_severity_alert_id"), "alerts")
