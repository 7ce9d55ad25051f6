"""Windows whose samples, and whose bin tables, have been purged."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0035"
down_revision: str | None = "0034"
branch_labels: str | None = None
depends_on: str | None = None

INDEXES = (
    ("ix_windows_with_samples", ["start_ns"], "samples_purged_ns IS NULL"),
    ("ix_windows_passed_over", ["wheelset", "start_ns"], "passed_over IS NOT NULL"),
)


def upgrade() -> None:
    """Add the columns; nothing has been purged yet."""
    op.add_column("windows", sa.Column("samples_purged_ns", sa.BigInteger(), nullable=True))
    op.add_column("windows", sa.Column("table_purged_ns", sa.BigInteger(), nullable=True))
    op.add_column("windows", sa.Column("passed_over", sa.String(16), nullable=True))
    for name, columns, where in INDEXES:
        op.create_index(name, "windows", columns, sqlite_where=sa.text(where), postgresql_where=sa.text(where))


def downgrade() -> None:
    """Remove them; what was purged is missing then."""
    for name, _, _ in INDEXES:
        op.drop_index(name, "windows")
    for column in ("passed_over", "table_purged_ns", "samples_purged_ns"):
        op.drop_column("windows", column)
