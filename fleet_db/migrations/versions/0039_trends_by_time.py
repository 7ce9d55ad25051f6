"""Index trends by when they were recorded: what was in force at a time is found however many versions came since."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0039"
down_revision: str | None = "0038"
branch_labels: str | None = None
depends_on: str | None = None

INDEX = "ix_trends_wheelset_recorded_ns_trend_id"


def upgrade() -> None:
    """Let no trend have been recorded before the one that it follows, as it is stored by now, and add the index."""
    connection = op.get_bind()
    trends = sa.table("trends", *(sa.column(name) for name in ("trend_id", "wheelset", "recorded_ns")))
    late: list[dict[str, int]] = []
    before: tuple[str, int] | None = None
    ordered = sa.select(trends.c.wheelset, trends.c.recorded_ns, trends.c.trend_id)
    for wheelset, recorded_ns, number in connection.execute(ordered.order_by(trends.c.wheelset, trends.c.trend_id)):
        if before is not None and before[0] == wheelset and recorded_ns < before[1]:
            late.append({"of": number, "at": before[1]})
        else:
            before = (wheelset, recorded_ns)
    if late:
        of_one = trends.update().where(trends.c.trend_id == sa.bindparam("of"))
        connection.execute(of_one.values(recorded_ns=sa.bindparam("at")), late)
    op.create_index(INDEX, "trends", ["wheelset", "recorded_ns", "trend_id"])


def downgrade() -> None:
    """Remove the index."""
    op.drop_index(INDEX, "trends")
