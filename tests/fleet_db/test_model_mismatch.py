"""The status of its own of what does not follow its class."""

from __future__ import annotations

import pytest
import sqlalchemy
import stored_values as make

from bench.put_values import put_geometry
from estimation.values.geometry import COMBINATIONS, BinStatus
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.storage import SqlStorage

WHY = Reason(ReasonCode.YAW_SPRING_DIFFERS, "a moment of +90%")
STATUS = sqlalchemy.text("SELECT status FROM results ORDER BY recorded_ns")


def test_it_is_stored_and_no_other_status_is(fleet: SqlStorage) -> None:
    wrong = make.geometry(1).mismatched(WHY)
    with fleet.write() as unit:
        put_geometry(unit, make.geometry_record(0, 100))
        put_geometry(unit, make.geometry_record(1, 200, geometry=wrong))
        found = unit.geometries.current("WS-1")
        assert found is not None
        assert make.same(found.geometry, wrong)
    with fleet.engine.connect() as connection:
        assert list(connection.execute(STATUS).scalars()) == ["estimated", "model_mismatch"]
    nonsense = sqlalchemy.text("UPDATE results SET status = 'nonsense'")
    with pytest.raises(sqlalchemy.exc.IntegrityError), fleet.engine.begin() as connection:
        connection.execute(nonsense)


def test_nothing_of_a_mismatched_geometry_is_a_number() -> None:
    before = make.geometry(3)
    found = before.mismatched(WHY)
    assert (found.status, found.reason) == (Status.MODEL_MISMATCH, WHY)
    numbers = (*found.conicity, found.equivalent_conicity, found.nonlinearity, found.zero_crossing)
    assert len(found.conicity) == len(before.conicity)
    for one in numbers:
        assert (one.value, one.std, one.low, one.high) == (None, None, None, None)
        assert (one.status, one.reason, one.count) == (Status.MODEL_MISMATCH, WHY, float(before.windows))
    for name in COMBINATIONS:
        values = getattr(found, name)
        assert set(values.status) == {BinStatus.UNOBSERVABLE}
        assert not (values.value == values.value).any(), "NaN throughout"
    assert make.same(found.samples, before.samples)
    assert found.windows == before.windows
