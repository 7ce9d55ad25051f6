"""A transaction on PostgreSQL in which nothing happens any more is ended, whatever its last statement was."""

from __future__ import annotations

import time

import pytest
from sqlalchemy import exc, text

from fleet_db.storage import SqlStorage


@pytest.mark.parametrize("rows", [1, 3])
def test_a_transaction_that_stands_still_is_ended_after_several_rows_too(
    postgres_storage: SqlStorage, rows: int
) -> None:
    with postgres_storage.engine.connect() as connection:
        connection.execute(text("CREATE TEMPORARY TABLE numbers (number INTEGER)"))
        connection.execute(text("SET LOCAL idle_in_transaction_session_timeout = 200"))
        connection.execute(text("INSERT INTO numbers VALUES (:number)"), [{"number": number} for number in range(rows)])
        time.sleep(1.0)
        with pytest.raises(exc.DBAPIError, match=r"idle-in-transaction|closed|terminat"):
            connection.execute(text("SELECT 1"))
        connection.invalidate()
