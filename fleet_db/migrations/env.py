"""How Alembic reaches the database: a connection handed over, or the URL on its command line (``-x url=...``)."""

from __future__ import annotations

from alembic import context
from sqlalchemy import Connection

from fleet_db.session import IMMEDIATE, database_engine
from fleet_db.tables import Base


def migrate(connection: Connection) -> None:
    """Run the migrations that were asked for, all in the transaction of ``connection``."""
    context.configure(
        connection=connection,
        target_metadata=Base.metadata,
        compare_type=True,
        compare_server_default=True,
        transactional_ddl=True,
        render_as_batch=connection.dialect.name == "sqlite",
    )
    with context.begin_transaction():
        context.run_migrations()


def main() -> None:
    """Find the connection and migrate."""
    given = context.config.attributes.get("connection")
    if given is not None:
        migrate(given)
        return
    engine = database_engine(context.get_x_argument(as_dictionary=True)["url"])
    with engine.connect().execution_options(**IMMEDIATE) as connection, connection.begin():
        migrate(connection)
    engine.dispose()


main()
