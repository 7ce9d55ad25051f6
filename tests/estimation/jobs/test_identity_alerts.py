"""A wheelset that is not the one on file, or not the way round, is found by its geometry and never averaged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from due_geometries import due_geometries
from one_database import on_sqlite
from test_wear_jobs import feed, feed_of, open_alert, run_jobs
from wheelset_life import DAY_NS, START_NS, geometry_of, geometry_record, register, run_windows

from bench.put_values import put_geometry
from estimation.alerts.identity import Mistake, Observation, identity_events
from estimation.jobs.steps.assumptions import identity_change
from estimation.storage import Storage
from estimation.values.alerts import AlertEventKind, CloseReason, Condition
from estimation.values.geometry import BinValues, GeometryRecord, WheelsetGeometry
from estimation.values.registry import Mounting

KM_A_DAY = 1000.0


def estimated_geometry(
    conicity: float, even: float, rng: np.random.Generator, *, mirrored: bool = False
) -> WheelsetGeometry:
    """Return what would be estimated: errors that neighbouring bins share, of scale and level, and wear's own."""
    plain = geometry_of(conicity=conicity * (1 + 0.01 * rng.standard_normal()), even=even)
    values = plain.rolling_radius_difference
    n = len(values.value)
    error = (
        4e-6 * np.convolve(rng.standard_normal(n + 4), np.full(5, 0.45), mode="valid") + 3e-6 * rng.standard_normal()
    )
    value, std = values.value + error, np.full(n, 5e-6)
    if mirrored:
        value, std = -value[::-1], std[::-1]
    return replace(plain, rolling_radius_difference=BinValues(value, std, values.status))


def life(
    serial: str, conicity: float, even: float, rng: np.random.Generator, days: int = 8, reversed_from: int = 99
) -> list[Observation]:
    return [
        Observation(
            serial,
            day * DAY_NS,
            (day + 1) * DAY_NS - 1,
            day * KM_A_DAY,
            estimated_geometry(conicity + 0.001 * day, even, rng, mirrored=day >= reversed_from),
        )
        for day in range(days)
    ]


def exchanged(first: Sequence[Observation], second: Sequence[Observation], day: int) -> dict[str, list[Observation]]:
    """Return the histories of two wheelsets under each other's name from a day on."""
    a, b = first[0].wheelset, second[0].wheelset
    return {
        a: [*first[:day], *(replace(item, wheelset=a) for item in second[day:])],
        b: [*second[:day], *(replace(item, wheelset=b) for item in first[day:])],
    }


def fleet(rng: np.random.Generator) -> list[list[Observation]]:
    """Return wheelsets whose conicities are 0.03 apart, every other one with wheels of unequal shape."""
    return [life(f"W{i}", 0.12 + 0.03 * i, 0.03 * (i % 2), rng) for i in range(6)]


def test_wear_and_noise_are_never_taken_for_a_mistake() -> None:
    for seed in range(60):
        histories = {one[0].wheelset: one for one in fleet(np.random.default_rng(seed))}
        assert identity_events(histories) == {}


def test_a_swap_is_found_in_both_and_in_no_other_wheelset() -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        lives = fleet(rng)
        i, j = (int(k) for k in sorted(rng.choice(6, 2, replace=False)))
        day = int(rng.integers(1, 8))
        histories = {one[0].wheelset: one for one in lives} | exchanged(lives[i], lives[j], day)
        events = identity_events(histories)
        assert set(events) == {f"W{i}", f"W{j}"}, (seed, events)
        for one, other in ((i, j), (j, i)):
            event = events[f"W{one}"]
            assert (event.mistake, event.partner) == (Mistake.SWAPPED, f"W{other}")
            assert event.before_ns < event.after_ns == day * DAY_NS


def test_an_interval_with_both_in_it_is_left_out() -> None:
    rng = np.random.default_rng(3)
    first, second = life("A", 0.12, 0.0, rng), life("B", 0.30, 0.0, rng)
    histories = exchanged(first, second, 4)
    for serial in histories:
        mixed = 0.5 * (0.12 + 0.30)
        histories[serial][4] = replace(histories[serial][4], geometry=estimated_geometry(mixed, 0.0, rng))
    events = identity_events(histories)
    assert {e.partner for e in events.values()} == {"A", "B"}
    assert {(e.before_ns, e.after_ns) for e in events.values()} == {(4 * DAY_NS - 1, 5 * DAY_NS)}


def test_a_wheelset_turned_round_is_found_where_its_wheels_differ_in_shape_and_only_there() -> None:
    for seed in range(40):
        rng = np.random.default_rng(seed)
        uneven, alike = (life("A", 0.2, even, rng, reversed_from=4) for even in (0.03, 0.0))
        event = identity_events({"A": uneven})["A"]
        assert (event.mistake, event.partner, event.after_ns) == (Mistake.REVERSED, None, 4 * DAY_NS)
        assert identity_events({"A": alike}) == {}


def test_what_nothing_explains_is_not_reported() -> None:
    rng = np.random.default_rng(1)
    turned = [*life("A", 0.30, 0.02, rng)[:4], *life("A", 0.10, 0.0, rng)[4:]]  # a lathe that was not recorded
    assert identity_events({"A": turned, "B": life("B", 0.2, 0.0, rng), "C": life("C", 0.1, 0.02, rng)}) == {}


def test_a_jump_at_another_time_is_no_swap() -> None:
    rng = np.random.default_rng(1)
    first, second = life("A", 0.12, 0.0, rng), life("B", 0.30, 0.0, rng)
    early, late = exchanged(first, second, 2), exchanged(first, second, 6)
    assert identity_events({"A": early["A"], "B": late["B"]}) == {}
    few = replace(first[0].geometry, windows=2)
    assert identity_events({"A": [replace(item, geometry=few) for item in early["A"]]}) == {}


def stored(storage: Storage, serial: str, history: Sequence[Observation]) -> None:
    """Store a history as interval geometries, and its last as the current one, a day each."""
    with storage.write() as unit:
        for day, item in enumerate(history, start=1):
            put_geometry(unit, _record(serial, day, day, item))
        put_geometry(unit, _record(serial, None, len(history), history[-1]))
    run_windows(storage, serial, len(history) - 0.5, 20)


def _record(serial: str, interval: int | None, day: int, item: Observation) -> GeometryRecord:
    conicity = item.geometry.equivalent_conicity.value or 0.0
    plain = geometry_record(serial, interval, day, conicity)
    return replace(plain, geometry=item.geometry, input_digest=f"{day} {conicity}", recorded_ns=day)


def swapped_fleet(storage: Storage) -> None:
    rng = np.random.default_rng(5)
    register(storage, "W1", "W2", "W3")
    first, second, third = (life(f"W{i}", g, 0.0, rng) for i, g in ((1, 0.15), (2, 0.46), (3, 0.2)))
    for serial, history in exchanged(first, second, 4).items():
        stored(storage, serial, history)
    stored(storage, "W3", third)


def test_a_swap_raises_both_and_no_wear_alert_and_the_trend_begins_again(storage: Storage) -> None:
    swapped_fleet(storage)
    run_jobs(storage, 8.2)
    alerts = {serial: open_alert(storage, serial, "identity") for serial in ("W1", "W2")}
    assert {serial: alert.evidence["partner"] for serial, alert in alerts.items()} == {"W1": "W2", "W2": "W1"}
    assert {alert.evidence["mistake"] for alert in alerts.values()} == {"swapped"}
    assert {kind for _, kind in feed_of(storage)} == {"identity"}  # 0.46 is over the limit of 0.40, but whose is it?
    feed_before = feed(storage)
    run_jobs(storage, 8.4)
    assert feed(storage) == feed_before
    with storage.read() as unit:
        trends = {serial: unit.trends.latest(serial) for serial in ("W1", "W2", "W3")}
        assert identity_change(unit, "W3") is None
        found = identity_change(unit, "W1")
        assert found is not None
        assert found.after_ns == START_NS + 4 * DAY_NS
        assert due_geometries(unit).count("W1") == 1
    lengths = {serial: len(trend.trend.value) for serial, trend in trends.items() if trend is not None}
    assert lengths == {"W1": 4, "W2": 4, "W3": 8}


@on_sqlite
@pytest.mark.parametrize("how", ["mounting", "exchange"])
def test_the_alert_stands_until_the_mounting_is_corrected(storage: Storage, how: str) -> None:
    swapped_fleet(storage)
    run_jobs(storage, 8.2)
    run_jobs(storage, 20.0)
    assert open_alert(storage, "W1", "identity").condition is Condition.ACTIVE
    with storage.write() as unit:
        if how == "mounting":
            unit.registry.add_mounting(Mounting("W1", "V1", 1, START_NS, None, 0.0, 0.0, reversed=True))
        else:
            unit.registry.add_mounting(Mounting("W1", "V1", 1, START_NS, START_NS + 9 * DAY_NS, 0.0, 0.0))
            unit.registry.add_mounting(Mounting("W1", "V1", 1, START_NS + 9 * DAY_NS, None, 9000.0, 9000.0))
    run_jobs(storage, 20.2)
    closed = [e.alert for e in feed(storage) if e.kind is AlertEventKind.CLOSED and e.alert.kind == "identity"]
    assert {(alert.wheelset, alert.close_reason) for alert in closed} == {
        ("W1", CloseReason.MOUNTING_CORRECTED if how == "mounting" else CloseReason.WHEELSET_EXCHANGED)
    }
    with storage.read() as unit:
        assert next((one for one in unit.alerts.all_open("W1") if one.kind == "identity"), None) is None
        assert identity_change(unit, "W1") is not None  # what was before stays apart
