"""Values put into stores one by one, as tests and benches have them; jobs put what a stage has made of many."""

from __future__ import annotations

from collections.abc import Sequence

from estimation.values.geometry import GEOMETRY, BinTable, GeometryRecord, WindowTable, result_of_geometry
from estimation.values.registry import Mounting
from estimation.values.runs import Result
from estimation.values.trend import TREND, TrendRecord, baseline_part
from fleet_db.storage import SqlUnitOfWork


def put_geometry(unit: SqlUnitOfWork, record: GeometryRecord) -> bool:
    """Put an estimate in force; False if that of its key has the same inputs, parameters and numerics."""
    news = unit.results.put_all(GEOMETRY, [result_of_geometry(record)])
    if news and record.interval is None:
        unit.geometries.show_bins([record.wheelset])
    return bool(news)


def put_trend(unit: SqlUnitOfWork, record: TrendRecord) -> bool:
    """Put a trend; False if the newest of its wheelset is of the same baseline, inputs and numerics."""
    result = Result(
        subject=record.wheelset,
        part=baseline_part(record.baseline),
        made_from=record.input_digest,
        numerics=record.code_version,
        recorded_ns=record.recorded_ns,
        value=record.trend,
        status=record.trend.status,
        reason=record.trend.reason,
        head=record.trend.head,
        parameters=record.parameters,
    )
    return bool(unit.results.put_all(TREND, [result]))


def put_table(
    unit: SqlUnitOfWork, wheelset: str, start_ns: int, table: BinTable, track_version: int | None, window_digest: str
) -> None:
    """Store the bin table of a window."""
    unit.tables.put_all([WindowTable(wheelset, start_ns, window_digest, table, track_version)])


def put_mountings(unit: SqlUnitOfWork, records: Sequence[Mounting], recorded_ns: int | None = None) -> None:
    """Add or change mountings together: wheelsets may change places."""
    before = unit.registry.take_out(records)
    for record in records:
        unit.registry.add_mounting(record, before.get((record.wheelset, record.from_ns)), recorded_ns)
