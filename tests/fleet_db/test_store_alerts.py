"""Alerts and their feed: the same on both databases."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import pytest
import sqlalchemy
import stored_values as make
from sqlalchemy.exc import IntegrityError

from estimation.alerts.rule_book import ALERT_RULES
from estimation.errors import ConflictError, NotFoundError, ParameterError
from estimation.values.alerts import Alert, AlertEventKind, AlertScope, CloseReason, Condition, Severity
from fleet_db.storage import SqlStorage
from fleet_db.stores.alerts import AlertChoice
from fleet_db.tables.alerts import AlertRow

RAISED, UPDATED, CLOSED = AlertEventKind.RAISED, AlertEventKind.UPDATED, AlertEventKind.CLOSED


def save(storage: SqlStorage, alert: Alert, *events: AlertEventKind) -> Alert:
    with storage.write() as unit:
        return unit.alerts.save(alert, events, 50, "someone", "a note")


def test_an_alert_comes_back_with_its_events(fleet: SqlStorage) -> None:
    saved = save(fleet, make.ALERT, RAISED, UPDATED)
    assert saved == replace(make.ALERT, alert_id=saved.alert_id, version=1)
    assert saved.alert_id > 0
    with fleet.read() as unit:
        assert unit.alerts.get(saved.alert_id) == saved
        assert next((one for one in unit.alerts.all_open("WS-1") if one.kind == "conicity_limit"), None) == saved
        assert next((one for one in unit.alerts.all_open("WS-1") if one.kind == "no_data"), None) is None
        first, second = unit.alerts.events(saved.alert_id)
        assert (first.kind, second.kind) == (RAISED, UPDATED)
        assert first.alert == second.alert == saved
        assert (first.recorded_ns, first.actor, first.note) == (50, "someone", "a note")
        assert list(unit.alerts.feed(0, 10)) == [first, second]
        assert list(unit.alerts.feed(first.sequence, 10)) == [second]
        assert list(unit.alerts.feed(0, 1)) == [first]


def test_events_keep_the_alert_as_it_was(fleet: SqlStorage) -> None:
    first = save(fleet, make.ALERT, RAISED)
    second = save(fleet, replace(first, severity=Severity.CRITICAL, external_refs=("WO-1",)), UPDATED)
    assert second.version == 2
    with fleet.read() as unit:
        assert [event.alert for event in unit.alerts.events(first.alert_id)] == [first, second]


def test_nothing_new_changes_nothing(fleet: SqlStorage) -> None:
    saved = save(fleet, make.ALERT, RAISED)
    assert save(fleet, saved) == saved
    assert save(fleet, replace(saved, last_seen_ns=99)) == replace(saved, last_seen_ns=99, version=2)
    with fleet.read() as unit:
        assert len(unit.alerts.feed(0, 10)) == 1


def test_an_alert_changed_since_it_was_read_is_refused(fleet: SqlStorage) -> None:
    saved = save(fleet, make.ALERT, RAISED)
    save(fleet, replace(saved, acknowledged_by="A"), AlertEventKind.ACKNOWLEDGED)
    with pytest.raises(ConflictError, match="is at version 2, not 1"):
        save(fleet, replace(saved, acknowledged_by="B"), AlertEventKind.ACKNOWLEDGED)
    with fleet.read() as unit:
        assert unit.alerts.get(saved.alert_id).acknowledged_by == "A"
        assert len(unit.alerts.feed(0, 10)) == 2


def test_one_open_alert_of_a_kind(fleet: SqlStorage) -> None:
    first = save(fleet, make.ALERT, RAISED)
    with pytest.raises(ConflictError, match=f"alert {first.alert_id} of kind conicity_limit is already open"):
        save(fleet, make.ALERT, RAISED)
    save(fleet, replace(make.ALERT, kind="no_data"), RAISED)
    save(fleet, replace(make.ALERT, wheelset="WS-2"), RAISED)
    save(fleet, replace(first, closed_ns=60, close_reason=CloseReason.REPROFILED), CLOSED)
    again = save(fleet, make.ALERT, RAISED)
    with pytest.raises(ConflictError, match="already open"):
        save(fleet, replace(first, version=2), UPDATED)  # reopening it would make two
    with fleet.read() as unit:
        assert next((one for one in unit.alerts.all_open("WS-1") if one.kind == "conicity_limit"), None) == again
        assert len(unit.alerts.all_open()) == 3
        assert len(unit.alerts.all_open("WS-1")) == 2


def test_one_open_alert_is_held_by_the_database_itself(fleet: SqlStorage) -> None:
    saved = save(fleet, make.ALERT, RAISED)
    with fleet.engine.connect() as connection, connection.begin():
        row = dict(connection.execute(sqlalchemy.select(AlertRow.table)).mappings().one())
    del row["alert_id"]
    with pytest.raises(IntegrityError), fleet.engine.begin() as connection:
        connection.execute(sqlalchemy.insert(AlertRow.table).values(**row))
    save(fleet, replace(saved, closed_ns=60), CLOSED)
    with fleet.engine.begin() as connection:
        connection.execute(sqlalchemy.insert(AlertRow.table).values(**row))


FLEET_ALERT = replace(make.ALERT, wheelset=None)


def test_one_open_fleet_alert_of_a_kind(fleet: SqlStorage) -> None:
    first = save(fleet, FLEET_ALERT, RAISED)
    save(fleet, make.ALERT, RAISED)  # one of a wheelset is another matter
    save(fleet, replace(FLEET_ALERT, kind="no_data"), RAISED)
    with pytest.raises(ConflictError, match=f"alert {first.alert_id} .* is already open for fleet 'F-1'"):
        save(fleet, FLEET_ALERT, RAISED)
    with fleet.engine.connect() as connection:
        statement = sqlalchemy.select(AlertRow.table).where(AlertRow.table.c.alert_id == first.alert_id)
        row = dict(connection.execute(statement).mappings().one())
    del row["alert_id"]
    with pytest.raises(IntegrityError), fleet.engine.begin() as connection:
        connection.execute(sqlalchemy.insert(AlertRow.table).values(**row))
    save(fleet, replace(first, closed_ns=60), CLOSED)
    with fleet.engine.begin() as connection:
        connection.execute(sqlalchemy.insert(AlertRow.table).values(**row))


def test_a_fleet_alert_stands_in_the_feed_for_members_raised_with_it(fleet: SqlStorage) -> None:
    fleet_alert = save(fleet, make.ALERT, RAISED)
    standing = save(fleet, FLEET_ALERT, RAISED)
    number = standing.alert_id
    fleet_alert = save(fleet, replace(fleet_alert, fleet_alert_id=number), UPDATED)
    quiet = save(fleet, replace(make.ALERT, wheelset="WS-2", fleet_alert_id=number), RAISED)
    quiet = save(fleet, replace(quiet, closed_ns=60), CLOSED)
    fleet_alert = save(fleet, replace(fleet_alert, closed_ns=61), CLOSED)
    with fleet.read() as unit:
        assert [(e.kind, e.alert.alert_id) for e in unit.alerts.feed(0, 10)] == [
            (RAISED, fleet_alert.alert_id),
            (RAISED, number),
            (UPDATED, fleet_alert.alert_id),
            (CLOSED, fleet_alert.alert_id),
        ]
        assert [(e.kind, e.alert.fleet_alert_id) for e in unit.alerts.events(quiet.alert_id)] == [
            (RAISED, number),
            (CLOSED, number),
        ]
        assert list(unit.alerts.members(number)) == [fleet_alert, quiet]
        assert list(unit.alerts.open_in_fleet("F-1")) == [standing]
        assert unit.alerts.open_in_fleet("F-2") == []


def test_members_are_alerts_of_wheelsets_and_their_fleet_alert_is_known(fleet: SqlStorage) -> None:
    standing = save(fleet, FLEET_ALERT, RAISED)
    with pytest.raises(ConflictError):
        save(fleet, replace(FLEET_ALERT, kind="no_data", fleet_alert_id=standing.alert_id), RAISED)
    with pytest.raises(ConflictError):
        save(fleet, replace(make.ALERT, fleet_alert_id=77), RAISED)
    with fleet.read() as unit:
        assert list(unit.alerts.all_open()) == [standing]


def test_pages_by_filter(fleet: SqlStorage) -> None:
    first = save(fleet, make.ALERT, RAISED)
    second = save(fleet, replace(make.ALERT, wheelset="WS-2", condition=Condition.UNKNOWN), RAISED)
    third = save(fleet, replace(make.ALERT, kind="no_data", closed_ns=70), CLOSED)
    with fleet.read() as unit:

        def page(after_id: int | None = None, limit: int = 100, **filters: Any) -> list[Alert]:  # noqa: ANN401
            numbers = [one.alert_id for one in unit.alerts.outlines(AlertChoice(**filters), after_id, limit)]
            return list(map(unit.alerts.some(numbers).__getitem__, numbers))

        assert page() == [first, second, third]
        assert page(limit=1) == [first]
        assert page(first.alert_id, limit=1) == [second]
        assert page(wheelset="WS-2") == page(condition=Condition.UNKNOWN) == [second]
        assert page(kind="no_data") == [third]
        assert page(open_only=True) == [first, second]
        assert page(fleet="F-2") == []
        assert page(scope=AlertScope.FLEET) == page(fleet_alert_id=first.alert_id) == []
        assert page(scope=AlertScope.WHEELSET) == [first, second, third]
    fourth = save(fleet, FLEET_ALERT, RAISED)
    first = save(fleet, replace(first, fleet_alert_id=fourth.alert_id))
    with fleet.read() as unit:
        assert page(scope=AlertScope.FLEET) == [fourth]
        assert page(scope=AlertScope.WHEELSET, open_only=True) == [first, second]
        assert page(fleet_alert_id=fourth.alert_id) == [first]


def test_bad_alerts_leave_nothing(fleet: SqlStorage) -> None:
    with pytest.raises(NotFoundError):
        save(fleet, replace(make.ALERT, alert_id=77), RAISED)
    with pytest.raises(ConflictError):
        save(fleet, replace(make.ALERT, wheelset="WS-9"), RAISED)
    with pytest.raises((ParameterError, ValueError)):
        save(fleet, replace(make.ALERT, evidence={"value": float("nan")}), RAISED)
    with fleet.read() as unit:
        assert unit.alerts.feed(0, 10) == unit.alerts.all_open() == []


def test_a_reader_of_the_feed_misses_nothing(fleet: SqlStorage) -> None:
    """Writers at once, each over several transactions; a reader that only asks for what is behind its cursor."""
    kinds, rounds = [rule.kind for rule in ALERT_RULES], 12
    done = threading.Event()
    seen: list[int] = []

    def write(kind: str) -> None:
        alert = save(fleet, replace(make.ALERT, kind=kind), RAISED)
        for round_ in range(rounds):
            alert = save(fleet, replace(alert, last_seen_ns=100 + round_), UPDATED, UPDATED)

    def follow() -> None:
        while True:
            last = done.is_set()
            with fleet.read() as unit:
                seen.extend(event.sequence for event in unit.alerts.feed(seen[-1] if seen else 0, 7))
                if last and not unit.alerts.feed(seen[-1], 1):
                    return

    with ThreadPoolExecutor(len(kinds) + 1) as pool:
        reader = pool.submit(follow)
        for writer in [pool.submit(write, kind) for kind in kinds]:
            writer.result()
        done.set()
        reader.result()
    with fleet.read() as unit:
        everything = [event.sequence for event in unit.alerts.feed(0, 10_000)]
    assert seen == everything
    assert len(everything) == len(kinds) * (1 + 2 * rounds)


def test_writers_who_read_first_lose_no_change(fleet: SqlStorage) -> None:
    saved = save(fleet, make.ALERT, RAISED)

    def see_again(_: int) -> None:
        with fleet.write() as unit:
            alert = unit.alerts.get(saved.alert_id)
            unit.alerts.save(replace(alert, occurrence_count=alert.occurrence_count + 1), (), 60)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(see_again, range(20)))
    with fleet.read() as unit:
        assert unit.alerts.get(saved.alert_id).occurrence_count == 21
