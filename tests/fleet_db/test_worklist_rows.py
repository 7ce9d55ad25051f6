"""The worklist beside the slow way that is obviously right: reading everything of each wheelset, one by one."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import sqlalchemy
import stored_values as make
from believed_now import with_ahead

from api.factory import SystemClock
from bench.put_values import put_geometry, put_trend
from estimation.errors import NotFoundError
from estimation.jobs.evaluate_alerts import WORKLIST
from estimation.jobs.job import JobContext
from estimation.jobs.runner import run
from estimation.jobs.settings import JobSettings
from estimation.trend.extrapolation import conicity_at_limit_amplitude
from estimation.trend.now import limit_now
from estimation.values.alerts import Alert, AlertEventKind, CloseReason, Condition, MileageNow, Severity, Urgency
from estimation.values.quantities import Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord
from estimation.values.windows import WindowRecord, WindowState
from fleet_db.packed_values import from_document
from fleet_db.records import Decision, RecordKind
from fleet_db.storage import SqlStorage, SqlUnitOfWork
from fleet_db.stores.registry_history import RecordKey
from fleet_db.stores.worklist import WorklistFilter, WorklistOrder, WorklistPlace

SERIALS = [f"D-{number:02d}" for number in range(12)]
KINDS = ("conicity_limit", "limit_forecast", "hunting", "no_data", "wheel_asymmetry")
DAY = 86_400_000_000_000


def drawn_fleet(storage: SqlStorage) -> None:
    """Store twelve wheelsets of two fleets, eight of them mounted."""
    with storage.write() as unit:
        for fleet in ("alpha", "beta"):
            unit.registry.add_fleet(FleetRecord(fleet, fleet))
        for number in (0, 1):
            unit.registry.add_vehicle(
                VehicleRecord(f"V-{number}", "alpha", f"class-{number}", 4, 44.0, (0.0, 2.5, 17.0, 19.5))
            )
        for number, serial in enumerate(SERIALS):
            mounting = None
            if number < 8:
                mounting = Mounting(serial, f"V-{number // 4}", number % 4 + 1, make.START, None, 0.0, 1000.0 * number)
            unit.registry.add_wheelset(WheelsetRecord(serial, "alpha" if number % 3 else "beta", "P8", 0.46, mounting))


@dataclass(frozen=True, slots=True)
class Happening:
    """What may happen to a wheelset next, as it is now."""

    random: np.random.Generator
    step: int
    record: WheelsetRecord
    alerts: Sequence[Alert]
    windows: Sequence[WindowRecord]
    mountings: Sequence[Mounting]
    voided: bool

    @classmethod
    def drawn(cls, random: np.random.Generator, step: int, storage: SqlStorage) -> Happening:
        serial = SERIALS[random.integers(len(SERIALS))]
        with storage.read() as unit:
            alerts, windows = unit.alerts.all_open(serial), unit.windows.list(serial)
            record, voided = unit.registry.wheelset(serial), unit.registry.voided(serial)
            return cls(random, step, record, alerts, windows, unit.registry.mountings(serial), voided)

    @property
    def serial(self) -> str:
        return self.record.serial

    @property
    def at_ns(self) -> int:
        return make.START + self.step * DAY

    def happen(self, unit: SqlUnitOfWork) -> None:
        if self.voided:
            unit.corrections.restore(RecordKey(RecordKind.WHEELSET, self.serial), Decision(reason="was right"))
            return
        often = (self.geometry, self.trend, self.trend, self.trend, self.window, self.window, self.mark, self.judge)
        possible = (*often, *often, self.alert, self.alert, self.reprofile, self.mount, self.vehicle, self.void)
        possible[self.random.integers(len(possible))](unit)

    def geometry(self, unit: SqlUnitOfWork) -> None:
        status = self.random.integers(8)
        found = make.geometry(self.step)
        amplitude = np.sort(found.amplitude)
        amplitude[-1] = 3e-3
        found = replace(found, amplitude=amplitude, windows=int(status > 0) * 30)
        if status == 1:
            found = found.mismatched(Reason(ReasonCode.YAW_SPRING_DIFFERS, "as on another spring"))
        fields = {"baseline": len(self.record.reprofilings), "geometry": found, "to_ns": self.at_ns}
        put_geometry(unit, make.geometry_record(self.step, self.at_ns, wheelset=self.serial, **fields))

    def trend(self, unit: SqlUnitOfWork) -> None:
        drawn = self.random.uniform(0, 400_000) + np.sort(self.random.uniform(0, 100_000, 3))
        found = replace(
            make.trend(self.step),
            mileage_km=np.sort(self.random.uniform(0, 30_000, 6)),
            distance_to_limit_km=Forecast(*(None if value > 300_000 else float(value) for value in drawn)),
            probability_over_limit=float(self.random.random() ** 6),
            status=Status.ESTIMATED if self.random.random() < 0.8 else Status.UNESTIMATED,
        )
        fields = {"baseline": len(self.record.reprofilings), "trend": with_ahead(found)}
        put_trend(unit, make.trend_record(self.step, self.at_ns, wheelset=self.serial, **fields))

    def window(self, unit: SqlUnitOfWork) -> None:
        found = make.window(self.step, samples=16, wheelset=self.serial, vehicle="V-0", track_section=None)
        unit.windows.put(found, float(self.random.uniform(0, 60_000)), self.at_ns)

    def mark(self, unit: SqlUnitOfWork) -> None:
        if self.windows:
            state = [WindowState.REFUSED, WindowState.PENDING][self.random.integers(2)]
            reason = Reason(ReasonCode.CLIPPED, "clipped") if state is WindowState.REFUSED else None
            unit.windows.mark(self.serial, self.windows[-1].start_ns, state, reason)

    def judge(self, unit: SqlUnitOfWork) -> None:
        reason = Reason(ReasonCode.ODOMETER_IMPLAUSIBLE, "no vehicle is as fast")
        unit.plausibility.judge({(self.serial, self.windows[-1].start_ns): reason} if self.windows else {})

    def alert(self, unit: SqlUnitOfWork) -> None:
        kind = KINDS[self.random.integers(len(KINDS))]
        drawn = {
            "severity": list(Severity)[self.random.integers(3)],
            "condition": list(Condition)[self.random.integers(4)],
            "shelved_until_ns": self.at_ns if self.random.random() < 0.3 else None,
        }
        standing = next((one for one in self.alerts if one.kind == kind), None)
        new = replace(make.ALERT, fleet=self.record.fleet, wheelset=self.serial, kind=kind)
        changed = replace(standing or new, **drawn)
        if standing is not None:
            changed = replace(changed, closed_ns=self.at_ns, close_reason=CloseReason.CLEARED)
        unit.alerts.save(changed, [AlertEventKind.UPDATED], self.at_ns)

    def reprofile(self, unit: SqlUnitOfWork) -> None:
        if self.record.reprofilings:
            key = RecordKey(RecordKind.REPROFILING, self.serial, self.record.reprofilings[-1].at_ns)
            unit.corrections.void(key, Decision(reason="never happened"))
        else:
            unit.registry.add_reprofiling(Reprofiling(self.serial, self.at_ns, 5.0))

    def mount(self, unit: SqlUnitOfWork) -> None:
        mounting, axle = self.record.mounting, int(self.random.integers(4)) + 1
        if mounting is None:
            if unit.registry.mounting_at("V-1", axle, self.at_ns) is None:
                unit.registry.add_mounting(Mounting(self.serial, "V-1", axle, self.at_ns, None, 0.0, 123.0))
        elif self.random.random() < 0.5:
            unit.registry.add_mounting(replace(mounting, to_ns=self.at_ns))
        else:
            key = RecordKey(RecordKind.MOUNTING, self.serial, mounting.from_ns)
            unit.corrections.void(key, Decision(reason="never happened"))

    def vehicle(self, unit: SqlUnitOfWork) -> None:
        found = unit.registry.vehicle("V-1")
        unit.registry.add_vehicle(replace(found, vehicle_class=f"class-{self.random.integers(3)}"))

    def void(self, unit: SqlUnitOfWork) -> None:
        if not self.mountings:
            unit.corrections.void(RecordKey(RecordKind.WHEELSET, self.serial), Decision(reason="a typing mistake"))


def slow_row(unit: SqlUnitOfWork, serial: str) -> dict[str, Any]:
    """Return what the row of a wheelset has to say, from everything that is stored of it."""
    record = unit.registry.wheelset(serial)
    geometry, trend = unit.geometries.current(serial), unit.trends.latest(serial)
    windows = unit.windows.list(serial)
    alerts = unit.alerts.all_open(serial)
    baseline = len(record.reprofilings)
    usable = [one.start_ns + one.length_ns for one in windows if one.state is not WindowState.REFUSED]
    read = [one for one in windows if one.implausible is None]
    mileage = MileageNow(read[-1].mileage_km, read[-1].start_ns) if read else None
    mounting = record.mounting
    if mounting is not None and (mileage is None or mileage.at_ns < mounting.from_ns):
        mileage = MileageNow(mounting.wheelset_mileage_km, mounting.from_ns)
    conicity, shown = None, None
    if geometry is not None and geometry.geometry.windows and geometry.baseline == baseline:
        conicity, shown = conicity_at_limit_amplitude(geometry.geometry), geometry.geometry
    current = trend is not None and trend.baseline == baseline
    slope = trend.trend.slope_per_1000_km.value if current else None
    limit = None if trend is None else trend.trend.limit
    ahead = limit_now(shown, trend.trend if current else None, limit, mileage).distance_to_limit_km
    return {
        "wheelset": record,
        "vehicle_class": None
        if record.mounting is None
        else unit.registry.vehicle(record.mounting.vehicle).vehicle_class,
        "conicity": None if conicity is None else conicity.value,
        "slope": slope,
        "distance": [ahead.p10, ahead.p50, ahead.p90],
        "mileage": None if mileage is None else mileage.mileage_km,
        "last_data_ns": max([*usable, *([geometry.to_ns] if geometry is not None else [])], default=None),
        "alerts": sorted((one.alert_id, one.kind, one.severity, one.condition, one.shelved_until_ns) for one in alerts),
    }


def shown_row(document: str) -> dict[str, Any]:
    """Return the same of a stored row."""
    row = from_document(document)
    state, ahead = row.state, row.state.distance_to_limit_km
    return {
        "wheelset": row.wheelset,
        "vehicle_class": row.vehicle_class,
        "conicity": state.conicity.value,
        "slope": state.slope_per_1000_km.value,
        "distance": [ahead.p10, ahead.p50, ahead.p90],
        "mileage": None if state.mileage is None else state.mileage.mileage_km,
        "last_data_ns": state.last_data_ns,
        "alerts": sorted(
            (one.alert_id, one.kind, one.severity, one.condition, one.shelved_until_ns) for one in state.alerts
        ),
    }


def listed(unit: SqlUnitOfWork, order: WorklistOrder, *, descending: bool = False, limit: int = 5) -> list[str]:
    """Return all documents in an order, page by page."""
    found: list[str] = []
    after: WorklistPlace | None = None
    while True:
        page = unit.worklist.page(WorklistFilter(), order, after, limit, descending=descending)
        assert len(page) <= limit
        found += [entry.document for entry in page]
        if len(page) < limit:
            return found
        after = page[-1].place


def test_rows_are_what_reading_everything_of_each_wheelset_says_after_whatever_happened(storage: SqlStorage) -> None:
    drawn_fleet(storage)
    random = np.random.default_rng(14)
    seen: set[Urgency] = set()
    for step in range(1, 161):
        happening = Happening.drawn(random, step, storage)
        with storage.write() as unit:
            happening.happen(unit)
        if step % 20:
            continue
        with storage.read() as unit:
            documents = listed(unit, WorklistOrder.SERIAL)
            expected = [slow_row(unit, serial) for serial in SERIALS if not unit.registry.voided(serial)]
        assert [shown_row(document) for document in documents] == expected
        rows = [from_document(document) for document in documents]
        seen |= {row.state.urgency for row in rows}
        for order in WorklistOrder:
            for descending in (False, True):
                with storage.read() as unit:
                    found = listed(unit, order, descending=descending, limit=2 + step // 40)
                ordered = [from_document(document).wheelset.serial for document in found]
                assert ordered == slow_order(rows, order, descending=descending)
    assert len(seen) >= 5  # else the draw shows little


def slow_order(rows: list[Any], order: WorklistOrder, *, descending: bool) -> list[str]:
    """Return the serials of rows in an order, unknown ones last."""

    def key(row: Any) -> Any:  # noqa: ANN401 - what Python can compare
        state, p10 = row.state, row.state.distance_to_limit_km.p10
        far = 1e9 if p10 is None else p10
        beyond = state.forecast_reason is not None and state.forecast_reason.code is ReasonCode.BEYOND_HORIZON
        over = state.urgency in {Urgency.OVER_LIMIT, Urgency.PROBABLY_OVER}
        p50 = state.distance_to_limit_km.p50
        return {
            WorklistOrder.SERIAL: 0,
            WorklistOrder.URGENCY: (state.urgency.rank, 1 - (state.probability_over_limit or 0.0) if over else far),
            WorklistOrder.DISTANCE_TO_LIMIT: (0, p50) if p50 is not None else ((1, far) if beyond else None),
            WorklistOrder.CONICITY: state.conicity.value,
            WorklistOrder.TREND: state.slope_per_1000_km.value,
            WorklistOrder.MILEAGE: None if state.mileage is None else state.mileage.mileage_km,
            WorklistOrder.LAST_DATA: state.last_data_ns,
        }[order]

    known = [row for row in rows if key(row) is not None]
    unknown = [row for row in rows if key(row) is None]
    known.sort(key=lambda row: (key(row), row.wheelset.serial), reverse=descending)
    unknown.sort(key=lambda row: row.wheelset.serial, reverse=descending)
    return [row.wheelset.serial for row in (*known, *unknown)]


def test_every_order_is_read_from_an_index(storage: SqlStorage) -> None:
    drawn_fleet(storage)
    sqlite = storage.engine.dialect.name == "sqlite"
    plans: list[str] = []

    def explain(connection: Any, _cursor: Any, statement: str, parameters: Any, *_: object) -> None:  # noqa: ANN401
        if "FROM worklist_entries" in statement:
            cursor = connection.connection.dbapi_connection.cursor()
            cursor.execute(f"EXPLAIN {'QUERY PLAN ' if sqlite else ''}{statement}", parameters)
            plans.append("; ".join(row[-1] for row in cursor.fetchall()))

    for chosen in (WorklistFilter(), WorklistFilter(fleet="alpha")):
        for order in WorklistOrder:
            for descending in (False, True):
                with storage.read() as unit:
                    if not sqlite:  # it sorts twelve rows, unless they are as dear to it as many
                        unit.connection.exec_driver_sql("SET LOCAL enable_seqscan = off; SET LOCAL enable_sort = off")
                    sqlalchemy.event.listen(unit.connection, "before_cursor_execute", explain)
                    (*_, last) = unit.worklist.page(chosen, order, None, 2, descending=descending)
                    unit.worklist.page(chosen, order, last.place, 2, descending=descending)
                    sqlalchemy.event.remove(unit.connection, "before_cursor_execute", explain)
    assert len(plans) >= 56
    assert not [plan for plan in plans if "TEMP B-TREE" in plan or "Sort" in plan]
    assert all("index" in plan.lower() for plan in plans)


def test_two_transactions_on_one_wheelset_lose_nothing_of_each_other(storage: SqlStorage) -> None:
    drawn_fleet(storage)
    first_done, failed = threading.Event(), []

    def put_window() -> None:
        first_done.wait(10.0)
        try:
            with storage.write() as unit:
                unit.windows.put(
                    make.window(3, samples=16, wheelset=SERIALS[0], vehicle="V-0", track_section=None), 4711.0, 1
                )
        except Exception as error:  # noqa: BLE001 - shown by the test
            failed.append(error)

    other = threading.Thread(target=put_window)
    other.start()
    with storage.write() as unit:
        alert = replace(make.ALERT, fleet="beta", wheelset=SERIALS[0])
        unit.alerts.save(alert, [AlertEventKind.RAISED], 1)
        unit.finish()  # the row is made, and locked until the commit
        first_done.set()
        other.join(0.3)
    other.join(30.0)
    assert failed == []
    with storage.read() as unit:
        state = from_document(unit.worklist.row(SERIALS[0])).state
    assert [one.kind for one in state.alerts] == ["conicity_limit"]
    assert state.mileage is not None
    assert state.mileage.mileage_km == 4711.0


def test_what_cannot_be_read_says_so_and_keeps_nobody_from_storing(storage: SqlStorage) -> None:
    drawn_fleet(storage)
    with storage.write() as unit:
        put_trend(unit, make.trend_record(1, 1, wheelset=SERIALS[1]))
        unit.connection.execute(sqlalchemy.text("UPDATE results SET value = :value"), {"value": b"TWPK?"})
    with storage.write() as unit:
        alert = replace(make.ALERT, fleet="alpha", wheelset=SERIALS[1], kind="hunting")
        unit.alerts.save(alert, [AlertEventKind.RAISED], 1)
    with storage.read() as unit:
        state = from_document(unit.worklist.row(SERIALS[1])).state
    assert (state.status, state.urgency) == (Status.INVALID, Urgency.WATCH)
    assert {reason.code for reason in state.reasons} == {ReasonCode.ALERT_OPEN, ReasonCode.FILE_DAMAGED}


def test_rows_of_another_form_are_made_again_by_the_next_run(storage: SqlStorage) -> None:
    drawn_fleet(storage)
    context = JobContext(storage, SystemClock(), "test", JobSettings())
    other = replace(WORKLIST, settings=lambda _: "another form")
    with storage.read() as unit:
        before = listed(unit, WorklistOrder.SERIAL)
    for stage, made in ((WORKLIST, False), (other, True)):
        with storage.write() as unit:
            unit.connection.execute(sqlalchemy.text("UPDATE worklist_entries SET document = ''"))
        run(stage, context)
        with storage.read() as unit:
            assert (listed(unit, WorklistOrder.SERIAL) == before) is made


def test_filters_choose_by_where_it_runs_how_it_is_and_what_is_open(storage: SqlStorage) -> None:
    drawn_fleet(storage)
    with storage.write() as unit:
        for serial, kind in ((SERIALS[1], "hunting"), (SERIALS[2], "no_data"), (SERIALS[2], "hunting")):
            alert = replace(make.ALERT, fleet="alpha", wheelset=serial, kind=kind)
            unit.alerts.save(alert, [AlertEventKind.RAISED], 1)

    def serials(**chosen: Any) -> list[str]:  # noqa: ANN401 - of a filter
        with storage.read() as unit:
            page = unit.worklist.page(WorklistFilter(**chosen), WorklistOrder.SERIAL, None, 100)
        return [entry.place.serial for entry in page]

    assert serials(fleet="beta") == SERIALS[::3]
    assert serials(vehicle="V-1") == SERIALS[4:8] == serials(vehicle_class="class-1")
    assert serials(alert_kind="hunting") == SERIALS[1:3]
    assert serials(alert_kind="no_data", fleet="beta") == []
    assert serials(alert_severity=Severity.WARNING) == SERIALS[1:3]
    assert serials(urgency=Urgency.NOT_MOUNTED) == SERIALS[8:]
    assert serials(urgency=Urgency.WATCH) == SERIALS[1:3]
    assert serials(status=Status.UNESTIMATED) == SERIALS
    with storage.seen_by(frozenset({"beta"})).read() as unit:
        page = unit.worklist.page(WorklistFilter(), WorklistOrder.URGENCY, None, 100)
        assert sorted(entry.place.serial for entry in page) == SERIALS[::3]
        with pytest.raises(NotFoundError):
            unit.worklist.row(SERIALS[1])
