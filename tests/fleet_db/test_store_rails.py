"""Wheels and rails apart as they are stored, on both databases."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from same_values import same_values

from estimation.values.opinions import (
    SECTION_RAILS,
    WHEELSET_RAILS,
    RailKey,
    RailPart,
    RailsFinding,
    RailsReference,
    RailTrend,
    SectionConicity,
    StoredCell,
    WheelKey,
    WheelPart,
    WheelsFinding,
)
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import Result
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
        assert [(one.wheel, one.rail, one.digest) for one in unit.rails.cells(["WS-1"])] == [
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
    section = RailsFinding(
        amplitude=(1e-3, 3e-3),
        reference_wheel_profile="P8",
        periods=(period,),
        trend=RailTrend(KNOWN, 3e-3, 3),
        limit=0.05,
        exceeded=True,
        reported_amplitude=1e-3,
    )
    found = [Result(code, "d" * 64, "v", 99, section) for code in ("S-7", "S-8")]
    with fleet.write() as unit:
        unit.results.replace_all(SECTION_RAILS, found)
        unit.results.replace_all(SECTION_RAILS, found[:1])
    with fleet.read() as unit:
        assert unit.results.latest(SECTION_RAILS, "S-7") == found[0]
        assert unit.results.latest(SECTION_RAILS, "S-8") is None


def test_another_fleet_sees_no_wheelset_and_no_cell(fleet: SqlStorage) -> None:
    part = WheelPart(WHEEL, None, (OPEN,), ("S-7",), 6, 10, 20)
    with fleet.write() as unit:
        unit.rails.put_cells([StoredCell(WHEEL, RAIL, "a" * 64, cell(), None)])
        unit.results.put_all(WHEELSET_RAILS, [Result("WS-1", "d" * 64, "v", 99, WheelsFinding((1e-3,), part))])
    seen_by_another = replace(fleet, visible_fleets=frozenset({"another"}))
    with seen_by_another.read() as unit:
        assert unit.results.latest(WHEELSET_RAILS, "WS-1") is None
        assert unit.rails.cells() == []
