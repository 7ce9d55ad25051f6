"""The status of its own of what does not follow its class, in databases old and new."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import sqlalchemy
import stored_values as make
from alembic import command
from alembic.config import Config
from sqlalchemy import Engine

from estimation.values.geometry import COMBINATIONS, BinStatus
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.migrate import upgrade
from fleet_db.revisions import SCRIPTS
from fleet_db.session import database_engine
from fleet_db.storage import SqlStorage

WHY = Reason(ReasonCode.YAW_SPRING_DIFFERS, "a moment of +90%")
STATUS = sqlalchemy.text("SELECT status FROM geometry_estimates ORDER BY recorded_ns")


@pytest.fixture(params=["sqlite", "postgresql"])
def engine(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Engine]:
    """Yield an engine on a database with all migrations, once on each."""
    url = f"sqlite:///{tmp_path / 'db.sqlite3'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("empty_postgres_url")
    upgrade(url)
    engine = database_engine(url)
    yield engine
    engine.dispose()


def migrate(engine: Engine, to: str, *, down: bool = False) -> None:
    config = Config()
    config.set_main_option("script_location", str(SCRIPTS))
    with engine.begin() as connection:
        config.attributes["connection"] = connection
        (command.downgrade if down else command.upgrade)(config, to)


def test_rows_survive_the_way_down_and_up_and_the_check_holds(engine: Engine, tmp_path: Path) -> None:
    storage = SqlStorage(engine, tmp_path / "files")
    make.populate(storage)
    wrong = make.geometry(1).mismatched(WHY)
    with storage.write() as unit:
        unit.geometries.put(make.geometry_record(0, 100))
        unit.geometries.put(make.geometry_record(1, 200, geometry=wrong))
        found = unit.geometries.current("WS-1")
        assert found is not None
        assert make.same(found.geometry, wrong)
    migrate(engine, "0009", down=True)
    with engine.connect() as connection:
        assert list(connection.execute(STATUS).scalars()) == ["estimated", "unestimated"]
    refused = sqlalchemy.text("UPDATE geometry_estimates SET status = 'model_mismatch'")
    with pytest.raises(sqlalchemy.exc.IntegrityError), engine.begin() as connection:
        connection.execute(refused)
    migrate(engine, "0010")
    with engine.begin() as connection:
        connection.execute(refused)
        assert set(connection.execute(STATUS).scalars()) == {"model_mismatch"}
    nonsense = sqlalchemy.text("UPDATE geometry_estimates SET status = 'nonsense'")
    with pytest.raises(sqlalchemy.exc.IntegrityError), engine.begin() as connection:
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
