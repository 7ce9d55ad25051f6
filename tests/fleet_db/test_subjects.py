"""Versions of subjects grow in the transaction that changes a fact, and only there."""

from __future__ import annotations

import pytest
from sqlalchemy import select

from estimation.values.runs import SubjectKind
from fleet_db.storage import SqlStorage
from fleet_db.subjects import VERSIONS

WHEELSET, SECTION = SubjectKind.WHEELSET, SubjectKind.SECTION


def versions(storage: SqlStorage) -> dict[tuple[str, str, str], int]:
    with storage.read() as unit:
        rows = unit.connection.execute(
            select(VERSIONS.c.kind, VERSIONS.c.subject, VERSIONS.c.facet, VERSIONS.c.version)
        )
        return {(kind, subject, facet): version for kind, subject, facet, version in rows}


def test_a_facet_is_raised_once_a_transaction(storage: SqlStorage) -> None:
    for _ in range(2):
        with storage.write() as unit:
            unit.subjects.raised(WHEELSET, "W1", "windows")
            unit.subjects.raised(WHEELSET, "W1", "windows")
            unit.subjects.raised(SECTION, None, "windows")
            assert unit.subjects.growth(("windows", "trend"), (WHEELSET, "W1")) == 1
    assert versions(storage) == {("wheelset", "W1", "windows"): 2, ("section", "", "windows"): 2}


def test_what_is_rolled_back_raises_nothing(storage: SqlStorage) -> None:
    with pytest.raises(RuntimeError, match="broken off"):
        _raise_and_break_off(storage)
    assert versions(storage) == {}


def _raise_and_break_off(storage: SqlStorage) -> None:
    with storage.write() as unit:
        unit.subjects.raised(WHEELSET, "W1", "windows")
        unit.subjects.flush()
        raise RuntimeError("broken off")
