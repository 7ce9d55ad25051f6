"""Roll-ups: sums of bin tables by mileage interval, to which a window is added once."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0028"
down_revision: str | None = "0027"
branch_labels: str | None = None
depends_on: str | None = None

TABLES = "window_bin_tables"
WINDOWS = (
    ("ix_windows_refused", "reason_code", "reason_code"),
    ("ix_windows_implausible", "start_ns", "implausible_code"),
)


def _serial() -> sa.types.TypeEngine[int]:
    return sa.BigInteger().with_variant(sa.Integer(), "sqlite")


def _of_wheelset(table: str) -> sa.ForeignKeyConstraint:
    return sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f(f"fk_{table}_wheelset_wheelsets"))


def upgrade() -> None:
    """Add the tables; every window with a bin table waits to be rolled up."""
    op.create_table(
        "roll_ups",
        sa.Column("number", _serial(), nullable=False),
        sa.Column("wheelset", sa.String(64), nullable=False),
        sa.Column("baseline", sa.Integer(), nullable=False),
        sa.Column("baseline_interval", sa.Integer(), nullable=False),
        sa.Column("side", sa.Integer(), nullable=False),
        sa.Column("table_key", sa.String(128), nullable=False),
        sa.Column("vehicle_class", sa.String(64), nullable=False),
        sa.Column("windows", sa.BigInteger(), nullable=False),
        sa.Column("content", sa.String(64), nullable=False),
        sa.Column("sealed", sa.Boolean(), server_default=sa.false(), nullable=False),
        sa.Column("summary", sa.JSON(), nullable=False),
        sa.Column("plain", sa.LargeBinary(), nullable=True),
        sa.Column("forgetting", sa.LargeBinary(), nullable=True),
        sa.CheckConstraint("windows >= 0", name=op.f("ck_roll_ups_windows_counted")),
        _of_wheelset("roll_ups"),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_roll_ups")),
        sa.UniqueConstraint(
            *("wheelset", "baseline", "baseline_interval", "side", "table_key", "vehicle_class"), name="uq_roll_ups_key"
        ),
    )
    op.create_table(
        "taken_tables",
        sa.Column("number", _serial(), nullable=False),
        sa.Column("wheelset", sa.String(64), nullable=False),
        sa.Column("roll_up", sa.BigInteger(), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("running_km", sa.Double(), nullable=False),
        sa.Column("line", sa.String(64), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        _of_wheelset("taken_tables"),
        sa.PrimaryKeyConstraint("number", name=op.f("pk_taken_tables")),
    )
    op.create_index(op.f("ix_taken_tables_wheelset"), "taken_tables", ["wheelset"])
    op.create_table(
        "roll_up_states",
        sa.Column("wheelset", sa.String(64), nullable=False),
        sa.Column("rules", sa.String(64), nullable=False),
        sa.Column("classes", sa.JSON(), nullable=False),
        sa.Column("odometers", sa.JSON(), nullable=False),
        sa.Column("earlier_digest", sa.String(64), nullable=True),
        sa.Column("earlier", sa.LargeBinary(), nullable=True),
        _of_wheelset("roll_up_states"),
        sa.PrimaryKeyConstraint("wheelset", name=op.f("pk_roll_up_states")),
    )
    op.create_table(
        "rolling_sums",
        sa.Column("wheelset", sa.String(64), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("window_digest", sa.String(64), nullable=False),
        sa.Column("assumed", sa.String(192), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        _of_wheelset("rolling_sums"),
        sa.PrimaryKeyConstraint("wheelset", "start_ns", name=op.f("pk_rolling_sums")),
    )
    op.add_column(TABLES, sa.Column("rolled", sa.Boolean(), server_default=sa.false(), nullable=False))
    op.add_column(TABLES, sa.Column("roll_up", sa.BigInteger(), nullable=True))
    op.add_column(TABLES, sa.Column("running_km", sa.Double(), nullable=True))
    op.add_column(TABLES, sa.Column("line", sa.String(64), nullable=True))
    op.create_index(
        "ix_window_bin_tables_waiting",
        TABLES,
        ["wheelset", "start_ns"],
        sqlite_where=sa.text("rolled = 0"),
        postgresql_where=sa.text("NOT rolled"),
    )
    op.create_index(op.f("ix_window_bin_tables_roll_up_start_ns"), TABLES, ["roll_up", "start_ns"])
    for index, column, where in WINDOWS:
        condition = sa.text(f"{where} IS NOT NULL")
        op.create_index(index, "windows", ["wheelset", column], sqlite_where=condition, postgresql_where=condition)
    op.add_column("looks", sa.Column("until_ns", sa.BigInteger(), nullable=True))
    op.add_column("looks", sa.Column("number", sa.BigInteger(), nullable=True))
    op.add_column(
        "wheelset_changes", sa.Column("touched", sa.BigInteger(), server_default=sa.text("0"), nullable=False)
    )


def downgrade() -> None:
    """Remove them; geometries are made from the bin tables."""
    op.drop_column("wheelset_changes", "touched")
    op.drop_column("looks", "number")
    op.drop_column("looks", "until_ns")
    for index, _, _ in WINDOWS:
        op.drop_index(index, "windows")
    op.drop_index(op.f("ix_window_bin_tables_roll_up_start_ns"), TABLES)
    op.drop_index("ix_window_bin_tables_waiting", TABLES)
    for column in ("line", "running_km", "roll_up", "rolled"):
        op.drop_column(TABLES, column)
    for table in ("rolling_sums", "roll_up_states", "taken_tables", "roll_ups"):
        op.drop_table(table)
