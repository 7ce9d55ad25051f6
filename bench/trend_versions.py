"""What a read of a trend costs where its wheelset has the versions of a year: 70,000, one after each new window."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from statistics import median

from sqlalchemy import insert, select

from api.factory import open_store
from api.pipeline import job_context
from api.settings import Settings
from bench.report import BenchRow
from bench.wheelset_recording import recorded
from bench.wheelset_year import SERIAL, WheelsetYear
from estimation.values.trend import TREND
from estimation.values.units import SECOND_NS
from fleet_db.migrate import upgrade
from fleet_db.rows import table_of
from fleet_db.storage import SqlStorage
from fleet_db.tables.operation import ResultRow
from tests.postgres_server import SAFE, stoppable_server

VERSIONS, AT_ONCE, ROUNDS, READS = 70_000, 5_000, 11, 40
REACH_MS = 2.0
RESULTS = table_of(ResultRow)


def rows() -> Iterator[BenchRow]:
    """Yield processor time of a read of the newest trend, and of the one that was believed half a year ago."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        server = stack.enter_context(stoppable_server(SAFE))
        for name, url in (("SQLite", None), ("PostgreSQL", server.url)):
            settings = Settings(data_dir=Path(folder) / name, database_url=url, _env_file=None)
            settings.data_dir.mkdir()
            upgrade(settings.url)
            with closing(open_store(settings)) as storage:
                context = job_context(settings, storage)
                WheelsetYear(context, storage, recorded(context, storage, settings)).put(1, 5)
                first_ns = _copied(storage)
                yield _row(f"{VERSIONS:,} trends of a wheelset, {name}: the newest", storage, None)
                half_ns = first_ns + VERSIONS // 2 * SECOND_NS
                yield _row(f"{VERSIONS:,} trends of a wheelset, {name}: as of the middle", storage, half_ns)


def _copied(storage: SqlStorage) -> int:
    """Store the newest trend again and again, each a second later; return when the first copy was recorded, ns."""
    with storage.read() as unit:
        newest = select(RESULTS).where(RESULTS.c.stage == TREND.stage, RESULTS.c.subject == SERIAL)
        row = unit.connection.execute(newest.order_by(RESULTS.c.result_id.desc()).limit(1)).mappings().one()
    values = {name: value for name, value in row.items() if name != "result_id"}
    first_ns = row["recorded_ns"] + SECOND_NS
    for begin in range(0, VERSIONS, AT_ONCE):
        numbers = range(begin, min(begin + AT_ONCE, VERSIONS))
        with storage.write() as unit:
            copies = [values | _times(first_ns + number * SECOND_NS) for number in numbers]
            unit.connection.execute(insert(RESULTS), copies)
    return int(first_ns)


def _times(recorded_ns: int) -> dict[str, int]:
    """Return the times of a trend that was followed by another a second later; the one in force stays so."""
    return {"recorded_ns": recorded_ns, "superseded_ns": recorded_ns + SECOND_NS}


def _row(what: str, storage: SqlStorage, as_of_ns: int | None) -> BenchRow:
    with storage.read() as unit:
        assert unit.trends.latest(SERIAL, as_of_ns) is not None
        spent = median(_cpu_ms(lambda: unit.trends.latest(SERIAL, as_of_ns)) for _ in range(ROUNDS))
    return BenchRow(what, f"{spent:.2f} ms of CPU in the store", f"< {REACH_MS:g} ms", spent < REACH_MS)


def _cpu_ms(read: Callable[[], object]) -> float:
    begin = time.process_time()
    for _ in range(READS):
        read()
    return 1e3 * (time.process_time() - begin) / READS
