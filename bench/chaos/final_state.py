"""What a deployment knows at rest, as one digest for each kind: without times of recording and numbers of versions."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Mapping

from sqlalchemy import text

from bench.counting import run_all
from estimation.alerts.rules.running_gear import HuntingRule
from estimation.alerts.rules.sensor_data import SensorFaultRule
from estimation.jobs.job import JobContext
from estimation.values.alerts import Alert
from fleet_db.packed_values import pack_geometry, pack_value
from fleet_db.storage import SqlStorage, SqlUnitOfWork

ROWS = {
    "receipts": "SELECT digest, vehicle, state, reason_code, first_ns, last_ns, frames FROM chunks",
    "windows": (
        "SELECT wheelset, start_ns, axle, track_section, state, reason_code, reason, content_digest, mileage_km"
        " FROM windows"
    ),
    "positions": (
        "SELECT wheelset, start_ns, content_digest, offset_m, scale, middle_m, reason_code, reason"
        " FROM window_positions"
    ),
    "bin tables": "SELECT wheelset, start_ns, parameter_key, packed FROM window_bin_tables",
    "alignments in force": (
        "SELECT e.section, e.number, e.windows, e.survey_code, e.survey, a.content_digest, b.content_digest"
        " FROM track_epochs e"
        " LEFT JOIN track_alignments a ON a.section = e.section AND a.version = e.version"
        " LEFT JOIN track_alignments b ON b.section = e.section AND b.version = e.same_since"
    ),
    "suspension": "SELECT vehicle, section, from_ns, to_ns, ratio, ratio_std FROM suspension_findings",
}

MOST_RUNS = 8
"""Runs of all jobs after which they must have come to rest."""

ON_WINDOWS = (SensorFaultRule.kind, HuntingRule.kind)
"""Alerts that stand by all windows in vehicle time; those on estimates stand by all intervals of mileage."""


OF_HISTORY = frozenset({"fleet alerts"})
"""What may differ by history: fleet alerts group alerts by the times at which they opened."""


def final_state(storage: SqlStorage) -> Mapping[str, str]:
    """Return a digest for each kind of what is stored."""
    with storage.read() as unit:
        found = {name: [repr(tuple(row)) for row in unit.connection.execute(text(sql))] for name, sql in ROWS.items()}
        found["geometries"] = list(_geometries(unit))
        found["trends"] = list(_trends(unit))
        alerts = [alert for alert in unit.alerts.all_open() if alert.wheelset is not None]
        found["fleet alerts"] = [_listed(alert) for alert in unit.alerts.all_open() if alert.wheelset is None]
        found["alerts on windows"] = [_listed(alert) for alert in alerts if alert.kind in ON_WINDOWS]
        found["alerts on estimates"] = [_listed(alert) for alert in alerts if alert.kind not in ON_WINDOWS]
    return {name: hashlib.sha256("\n".join(sorted(rows)).encode()).hexdigest()[:16] for name, rows in found.items()}


def _listed(alert: Alert) -> str:
    return repr((alert.kind, alert.fleet, alert.wheelset, alert.condition.value, alert.severity.value))


def _geometries(unit: SqlUnitOfWork) -> Iterator[str]:
    """Yield the geometries that hold, the current one of each wheelset and those of its intervals."""
    for wheelset in unit.registry.wheelsets():
        current = unit.geometries.current(wheelset.serial)
        for record in [*unit.geometries.intervals(wheelset.serial), *([] if current is None else [current])]:
            if record.geometry.windows:
                key = (record.wheelset, record.baseline, record.interval, record.mileage_km, record.from_ns)
                yield repr((*key, hashlib.sha256(pack_geometry(record.geometry)).hexdigest()))


def _trends(unit: SqlUnitOfWork) -> Iterator[str]:
    for wheelset in unit.registry.wheelsets():
        latest = unit.trends.latest(wheelset.serial)
        if latest is not None:
            yield repr((wheelset.serial, latest.baseline, hashlib.sha256(pack_value(latest.trend)).hexdigest()))


def compared_state(storage: SqlStorage) -> Mapping[str, str]:
    """Return digests of what does not depend on the history."""
    return {name: digest for name, digest in final_state(storage).items() if name not in OF_HISTORY}


def come_to_rest(storage: SqlStorage, context: JobContext) -> tuple[Counter[str], bool]:
    """Run all jobs until nothing changes any more; return their counts, and whether they came to rest."""
    counts = Counter[str]()
    for _ in range(MOST_RUNS):
        before = final_state(storage)
        counts += run_all(context)
        if final_state(storage) == before:
            return counts, True
    return counts, False
