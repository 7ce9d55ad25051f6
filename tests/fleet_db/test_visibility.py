"""What a caller bound to fleets reads of the database."""

from __future__ import annotations

import pytest
from sqlalchemy import MetaData, Table, select

from fleet_db.tables.base import Base
from fleet_db.visibility import HIDDEN, RULES, SHARED, narrowed


def test_every_table_says_who_sees_it() -> None:
    listed = [*RULES, *SHARED, *HIDDEN]
    assert len(listed) == len(set(listed))
    assert set(Base.metadata.tables) - set(listed) == set()


def test_a_table_that_is_not_listed_is_refused() -> None:
    with pytest.raises(LookupError, match="invented"):
        narrowed(select(Table("invented", MetaData())), frozenset({"alpha"}))
