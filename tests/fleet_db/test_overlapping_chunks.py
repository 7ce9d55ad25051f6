"""Recordings that overlap a span: the same as by comparing with each, and read by index however many there are."""

from __future__ import annotations

import numpy as np
import pytest
import sqlalchemy

from fleet_db.records import ChunkRecord, ChunkState
from fleet_db.session import sqlite_file
from fleet_db.storage import SqlStorage

SECOND_NS = 1_000_000_000
LENGTHS_NS = np.array([0, 10, 60, 61, 900, 3600, 3601, 90_000]) * SECOND_NS


def record(number: int, vehicle: str, first_ns: int, last_ns: int, state: ChunkState) -> ChunkRecord:
    counts = {"recorder_first_ns": first_ns + 5 * SECOND_NS, "recorder_last_ns": last_ns + 5 * SECOND_NS}
    named = (f"{number:064x}", vehicle, ".blf", 10, state, None, first_ns, last_ns)
    return ChunkRecord(*named, frames=1, counts=counts, received_ns=1, recorded_ns=1)


@pytest.mark.parametrize("seed", range(3))
def test_what_overlaps_is_what_a_comparison_with_each_finds(storage: SqlStorage, seed: int) -> None:
    random = np.random.default_rng(seed)
    records = []
    for number in range(300):
        first_ns = int(random.integers(0, 400_000)) * SECOND_NS
        last_ns = first_ns + int(random.choice(LENGTHS_NS)) + int(random.integers(-1, 2)) * int(random.integers(0, 2))
        state = ChunkState.DECODED if random.random() < 0.9 else ChunkState.SET_ASIDE
        records.append(record(number, f"V-{random.integers(2)}", first_ns, max(first_ns, last_ns), state))
    with storage.write() as unit:
        for one in records:
            unit.chunks.put(one)
    with storage.read() as unit:
        for _ in range(60):
            chosen = records[int(random.integers(len(records)))]
            from_ns = int(random.choice([chosen.first_ns or 0, chosen.last_ns or 0])) + int(random.integers(-1, 2))
            to_ns = from_ns + int(random.choice([1, SECOND_NS, 100_000 * SECOND_NS]))
            same = [r for r in records if r.vehicle == "V-1" and r.state is ChunkState.DECODED]
            wanted = [r for r in same if (r.first_ns or 0) < to_ns and (r.last_ns or 0) >= from_ns]
            wanted.sort(key=lambda r: (r.first_ns or 0, r.digest))
            assert list(unit.chunks.overlapping("V-1", from_ns, to_ns)) == wanted
            later = 5 * SECOND_NS
            assert list(unit.chunks.overlapping_by_recorder("V-1", from_ns + later, to_ns + later)) == wanted


def test_each_length_is_read_by_its_index(storage: SqlStorage) -> None:
    asked: list[tuple[str, object]] = []

    @sqlalchemy.event.listens_for(storage.engine, "before_cursor_execute")
    def keep(_c: object, _cursor: object, statement: str, parameters: object, *_: object) -> None:
        asked.append((statement, parameters))

    on_file = sqlite_file(storage.engine) is not None
    with storage.write() as unit:
        for number in range(0 if on_file else 3000):  # a small table is read whole, and rightly so
            first_ns = number * 10 * SECOND_NS
            unit.chunks.put(record(number, "V-1", first_ns, first_ns + 10 * SECOND_NS, ChunkState.DECODED))
        if not on_file:
            unit.connection.execute(sqlalchemy.text("ANALYZE chunks"))
        for find, column in (
            (unit.chunks.overlapping, "first_ns"),
            (unit.chunks.overlapping_by_recorder, "recorder_first_ns"),
        ):
            find("V-1", 29_000 * SECOND_NS, 29_010 * SECOND_NS)
            statement, parameters = asked[-1]
            explain = "EXPLAIN QUERY PLAN " if on_file else "EXPLAIN "
            plan = unit.connection.exec_driver_sql(explain + statement, parameters)  # type: ignore[arg-type]
            text = "\n".join(str(row) for row in plan)
            for name in ("short", "middle", "long"):
                assert f"ix_chunks_{name}_{column}" in text, text
