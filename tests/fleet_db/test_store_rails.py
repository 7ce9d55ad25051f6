"""Wheels and rails apart as they are stored, on both databases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from same_values import same_values

from estimation.values.quantities import Estimate, Status
from estimation.values.rails import (
    RailKey,
    RailPart,
    RailsReference,
    RailTrend,
    SectionConicity,
    SectionRailsRecord,
    StoredCell,
    WheelKey,
    WheelPart,
    WheelsetRailsRecord,
)
from estimation.values.reasons import Reason, ReasonCode
from fleet_db.storage import SqlStorage

WHEEL, RAIL = WheelKey("WS-1", 0, 3), RailKey("S-7", 110)
WHY = Reason(ReasonCode.CONICITY_OPEN, "open")
KNOWN = Estimate(0.1, 0.01, 0.08, 0.12, 6.0, Status.ESTIMATED)
OPEN = Estimate.unknown(WHY, 6.0)


def cell() -> SectionConicity:
    return SectionConicity(
        wheel=WHEEL,
        rail=RAIL,
        amplitude=np.array([1e-3, 3e-3]),
        conicity=np.array([0.1 + 2**-50, np.nan]),
        sampled=np.array([0.01, np.nan]),
        systematic=np.array([0.0, np.nan]),
        scale_std=0.02,
        windows=6,
        from_ns=10,
        to_ns=20,
    )


def test_cells_come_back_to_the_last_bit(fleet: SqlStorage) -> None:
    known, open_ = StoredCell(WHEEL, RAIL, "a" * 64, cell(), None), replace(WHEEL, interval=4)
    refused = StoredCell(open_, RAIL, "b" * 64, None, WHY)
    with fleet.write() as unit:
        unit.rails.put_cells([refused, known])
    with fleet.read() as unit:
        found = unit.rails.cells()
        assert [(one.wheel, one.rail, one.digest) for one in unit.rails.cells("WS-1")] == [
            (WHEEL, RAIL, "a" * 64),
            (open_, RAIL, "b" * 64),
        ]
    assert found[1] == refused
    assert found[0].cell is not None
    assert same_values(found[0].cell, cell())


def test_a_cell_replaces_the_one_of_its_key_and_is_removed_by_it(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.rails.put_cells([StoredCell(WHEEL, RAIL, "a" * 64, cell(), None)])
        unit.rails.put_cells([StoredCell(WHEEL, RAIL, "b" * 64, None, WHY)])
        assert [one.digest for one in unit.rails.cells()] == ["b" * 64]
        unit.rails.drop_cells([(WHEEL, RAIL), (replace(WHEEL, interval=9), RAIL)])
        assert unit.rails.cells() == []


def test_what_is_found_replaces_all_that_was_found(fleet: SqlStorage) -> None:
    period = RailPart(RAIL, RailsReference.KNOWN_RAILS, (KNOWN, OPEN), (KNOWN, OPEN), (OPEN, OPEN), 4, 24, 10, 20)
    section = SectionRailsRecord(
        section="S-7",
        amplitude=(1e-3, 3e-3),
        reference_wheel_profile="P8",
        periods=(period,),
        trend=RailTrend(KNOWN, 3e-3, 3),
        limit=0.05,
        exceeded=True,
        reported_amplitude=1e-3,
        input_digest="d" * 64,
        code_version="v",
        recorded_ns=99,
    )
    part = WheelPart(WHEEL, RailsReference.MEAN, (OPEN, OPEN), ("S-7",), 6, 10, 20)
    wheelset = WheelsetRailsRecord((1e-3, 3e-3), part, "d" * 64, "v", 99)
    with fleet.write() as unit:
        assert unit.rails.input_digest() is None
        unit.rails.put_found([section], [wheelset])
    with fleet.read() as unit:
        assert unit.rails.of_section("S-7") == section
        assert unit.rails.of_wheelset("WS-1") == wheelset
        assert unit.rails.input_digest() == ("d" * 64, "v")
    with fleet.write() as unit:
        unit.rails.put_found([], [replace(wheelset, recorded_ns=100)])
    with fleet.read() as unit:
        assert unit.rails.of_section("S-7") is None
        assert unit.rails.of_wheelset("WS-1") == replace(wheelset, recorded_ns=100)


def test_another_fleet_sees_no_wheelset_and_no_cell(fleet: SqlStorage) -> None:
    part = WheelPart(WHEEL, None, (OPEN,), ("S-7",), 6, 10, 20)
    with fleet.write() as unit:
        unit.rails.put_cells([StoredCell(WHEEL, RAIL, "a" * 64, cell(), None)])
        unit.rails.put_found([], [WheelsetRailsRecord((1e-3,), part, "d" * 64, "v", 99)])
    seen_by_another = replace(fleet, visible_fleets=frozenset({"another"}))
    with seen_by_another.read() as unit:
        assert unit.rails.of_wheelset("WS-1") is None
        assert unit.rails.cells() == []
