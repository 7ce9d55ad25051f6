"""Which deployment a database belongs to: settings, locks, owners of runs."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0015"
down_revision: str | None = "0014"
branch_labels: str | None = None
depends_on: str | None = None

ONE_SCHEDULER = sa.text("kind = 'schedule'")


def upgrade() -> None:
    """Add owners of runs and stored settings; runs that never ended belong to processes that are gone."""
    op.create_table(
        "job_owners",
        sa.Column("token", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("holder", sa.Text(), nullable=False),
        sa.Column("since_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("kind IN ('schedule', 'api', 'cli')", name=op.f("ck_job_owners_kind_known")),
        sa.PrimaryKeyConstraint("token", name=op.f("pk_job_owners")),
        sqlite_autoincrement=True,
    )
    op.create_index(
        "ix_job_owners_one_scheduler",
        "job_owners",
        ["kind"],
        unique=True,
        sqlite_where=ONE_SCHEDULER,
        postgresql_where=ONE_SCHEDULER,
    )
    op.create_table(
        "stored_settings",
        sa.Column("name", sa.String(length=64), nullable=False),
        sa.Column("value", sa.Text(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("name", name=op.f("pk_stored_settings")),
    )
    op.add_column("job_runs", sa.Column("owner", sa.BigInteger(), nullable=True))
    op.execute(
        "UPDATE job_runs SET outcome = 'abandoned', finished_ns = started_ns,"
        " error = 'the process ended during the run' WHERE outcome = 'running'"
    )


def downgrade() -> None:
    """Remove them; what was abandoned stays so."""
    op.drop_column("job_runs", "owner")
    op.drop_table("stored_settings")
    op.drop_index("ix_job_owners_one_scheduler", table_name="job_owners")
    op.drop_table("job_owners")
