"""Fleets, vehicles, wheelsets with what happened to them, tracks: the same on both databases."""

from __future__ import annotations

from dataclasses import replace

import pytest
import stored_values as make
from due_geometries import due_geometries, see_geometries

from bench.put_values import put_geometry
from estimation.errors import ConflictError, NotFoundError, ParameterError
from estimation.values.registry import FleetRecord, Mounting, Reprofiling, VehicleRecord, WheelsetRecord
from fleet_db.storage import SqlStorage

HOUR = 3600 * make.SECOND


def test_what_was_stored_comes_back(fleet: SqlStorage) -> None:
    with fleet.read() as unit:
        assert unit.registry.fleets() == [FleetRecord("F-1", "Fleet one")]
        assert unit.registry.vehicle("V-2") == VehicleRecord("V-2", "F-1", "regional", 4, 44.4, (0.0, 2.5, 17.0, 19.5))
        assert unit.registry.wheelset("WS-1") == WheelsetRecord("WS-1", "F-1", "P8", 0.45, make.MOUNTING)
        assert [record.serial for record in unit.registry.wheelsets("F-1")] == ["WS-1", "WS-2", "WS-3"]
        assert unit.registry.wheelsets("nobody") == []
        assert unit.registry.mountings("WS-2") == [make.second_mounting()]


def test_a_repeat_changes_nothing(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        for wheelset in unit.registry.wheelsets():
            put_geometry(unit, make.geometry_record(wheelset=wheelset.serial))
        see_geometries(unit)
    make.populate(fleet)
    with fleet.read() as unit:
        assert due_geometries(unit) == []
        assert len(unit.registry.vehicles_page(None, None, 100)) == 2


def test_another_value_replaces(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.registry.add_fleet(FleetRecord("F-1", "renamed"))
        unit.registry.add_wheelset(WheelsetRecord("WS-3", "F-1", "S1002", 0.41, None))
    with fleet.read() as unit:
        assert unit.registry.fleets() == [FleetRecord("F-1", "renamed")]
        assert unit.registry.wheelset("WS-3").wheel_profile == "S1002"


def test_pages_follow_each_other(fleet: SqlStorage) -> None:
    with fleet.read() as unit:
        pages = unit.registry
        assert [record.code for record in pages.vehicles_page("F-1", None, 1)] == ["V-1"]
        assert [record.code for record in pages.vehicles_page("F-1", "V-1", 1)] == ["V-2"]


def test_a_wheelset_is_exchanged(fleet: SqlStorage) -> None:
    ended = replace(make.MOUNTING, to_ns=make.START + HOUR)
    following = replace(make.MOUNTING, wheelset="WS-3", from_ns=make.START + HOUR)
    with fleet.write() as unit:
        unit.registry.add_mounting(ended)
        unit.registry.add_mounting(following)
    with fleet.read() as unit:
        registry = unit.registry
        assert registry.mounting_at("V-1", 1, make.START - 1) is None
        assert registry.mounting_at("V-1", 1, make.START) == ended
        assert registry.mounting_at("V-1", 1, make.START + HOUR - 1) == ended
        assert registry.mounting_at("V-1", 1, make.START + HOUR) == following
        assert registry.mounting_at("V-1", 2, make.START) is None

        def at_first_axle(from_ns: int, to_ns: int) -> list[Mounting]:
            return [item for item in registry.mountings_on("V-1", from_ns, to_ns) if item.axle == 1]

        assert registry.mountings_on("V-1", 0, make.START) == []
        assert at_first_axle(0, make.START + HOUR) == [ended]
        assert at_first_axle(make.START + HOUR - 1, make.START + 2 * HOUR) == [ended, following]
        assert at_first_axle(make.START + HOUR, make.START + 2 * HOUR) == [following]
        assert registry.wheelset("WS-1").mounting is None
        assert registry.wheelset("WS-3").mounting == following


@pytest.mark.parametrize(
    "mounting",
    [
        pytest.param(replace(make.MOUNTING, vehicle="V-2", from_ns=make.START + HOUR), id="wheelset in two places"),
        pytest.param(replace(make.MOUNTING, wheelset="WS-3", from_ns=make.START + HOUR), id="two at one axle, after"),
        pytest.param(replace(make.MOUNTING, wheelset="WS-3", from_ns=0), id="two at one axle, before"),
        pytest.param(
            replace(make.MOUNTING, wheelset="WS-3", from_ns=0, to_ns=make.START + 1), id="last nanosecond shared"
        ),
    ],
)
def test_overlapping_mountings_are_refused(fleet: SqlStorage, mounting: Mounting) -> None:
    with pytest.raises(ConflictError, match="overlaps wheelset 'WS-1' at axle 1 of 'V-1'"), fleet.write() as unit:
        unit.registry.add_mounting(mounting)
    with fleet.read() as unit:
        assert unit.registry.mountings("WS-1") == [make.MOUNTING]
        assert unit.registry.mountings("WS-3") == []


def test_a_mounting_may_end_when_the_next_begins(fleet: SqlStorage) -> None:
    earlier = replace(make.MOUNTING, wheelset="WS-3", from_ns=0, to_ns=make.START)
    with fleet.write() as unit:
        unit.registry.add_mounting(earlier)
    with fleet.read() as unit:
        assert unit.registry.mountings("WS-3") == [earlier]


@pytest.mark.parametrize(
    ("change", "field"), [({"axle": 5}, "axle"), ({"axle": 0}, "axle"), ({"to_ns": make.START}, "to_ns")]
)
def test_an_impossible_mounting_names_the_field(fleet: SqlStorage, change: dict[str, int], field: str) -> None:
    with pytest.raises(ParameterError) as caught, fleet.write() as unit:
        unit.registry.add_mounting(replace(make.MOUNTING, **change))
    assert caught.value.field == field


def test_reprofilings_belong_to_the_wheelset(fleet: SqlStorage) -> None:
    visits = (Reprofiling("WS-1", 5, 100.0, "flats"), Reprofiling("WS-1", 9, 250_000.0))
    with fleet.write() as unit:
        for visit in reversed(visits):
            unit.registry.add_reprofiling(visit)
    with fleet.read() as unit:
        assert unit.registry.wheelset("WS-1").reprofilings == visits
        assert unit.registry.wheelset("WS-2").reprofilings == ()


def test_measured_profiles_come_back_exactly_in_the_order_of_time(fleet: SqlStorage) -> None:
    first, second = make.measured_profiles(make.START, 1), make.measured_profiles(make.START + 1, 5)
    with fleet.write() as unit:
        unit.registry.add_measured_profiles(second)
        unit.registry.add_measured_profiles(first)
    with fleet.read() as unit:
        assert make.same(tuple(unit.registry.measured_profiles("WS-1")), (first, second))
        assert unit.registry.measured_profiles("WS-2") == []
        assert unit.registry.measured_profiles("nobody") == []


def test_profiles_measured_at_the_same_time_replace(fleet: SqlStorage) -> None:
    first = make.measured_profiles(make.START)
    with fleet.write() as unit:
        unit.registry.add_measured_profiles(first)
    for other in (make.measured_profiles(make.START, 3), replace(first, mileage_km=7.0), replace(first, std=2e-4)):
        with fleet.write() as unit:
            unit.registry.add_measured_profiles(other)
        with fleet.read() as unit:
            assert make.same(tuple(unit.registry.measured_profiles("WS-1")), (other,))


def test_the_unknown_is_named(fleet: SqlStorage) -> None:
    with fleet.read() as unit:
        for call, message in (
            (lambda: unit.registry.vehicle("V-9"), "no vehicle 'V-9'"),
            (lambda: unit.registry.wheelset("x"), "no wheelset 'x'"),
            (lambda: unit.tracks.section("S-0"), "no track section 'S-0'"),
        ):
            with pytest.raises(NotFoundError, match=message):
                call()
    with pytest.raises(NotFoundError, match="no fleet 'F-9'"), fleet.write() as unit:
        unit.registry.add_wheelset(WheelsetRecord("new", "F-9", "P8", 0.45, None))
    with pytest.raises(NotFoundError, match="no wheelset 'WS-9'"), fleet.write() as unit:
        unit.registry.add_reprofiling(Reprofiling("WS-9", 1, 1.0))
    with pytest.raises(NotFoundError, match="no wheelset 'WS-9'"), fleet.write() as unit:
        unit.registry.add_measured_profiles(replace(make.measured_profiles(1), wheelset="WS-9"))


def test_sections_by_code_and_number(fleet: SqlStorage) -> None:
    with fleet.write() as unit:
        unit.tracks.add_section(make.SECTION)
        assert unit.tracks.sections() == [make.SECTION]
        assert unit.tracks.section_by_number(7) == make.SECTION
        assert unit.tracks.section_by_number(8) is None
        with pytest.raises(ConflictError, match="'S-7' already has number 7"):
            unit.tracks.add_section(replace(make.SECTION, code="S-8"))


def test_alignments_are_versions(fleet: SqlStorage) -> None:
    first, second = make.alignment(1), make.alignment(2)
    with fleet.write() as unit:
        assert unit.tracks.alignment("S-7") is None
        assert [unit.tracks.add_alignment(one) for one in (first, first, second, first, first)] == [1, 1, 2, 3, 3]
    with fleet.read() as unit:
        assert make.same(unit.tracks.alignment("S-7", 1), replace(first, version=1))
        assert make.same(unit.tracks.alignment("S-7", 2), replace(second, version=2))
        assert make.same(unit.tracks.alignment("S-7"), replace(first, version=3))
        assert unit.tracks.alignment("S-7", 4) is None
    with pytest.raises(NotFoundError), fleet.write() as unit:
        unit.tracks.add_alignment(replace(first, section="S-8"))


def test_layouts_are_versions(fleet: SqlStorage) -> None:
    first, second = make.layout(1), make.layout(2)
    with fleet.write() as unit:
        unit.tracks.add_section(make.SECTION)
        assert unit.tracks.layout("S-7") is None
        assert unit.tracks.layout_version("S-7") is None
        assert [unit.tracks.add_layout(one) for one in (first, first, second, first)] == [1, 1, 2, 3]
    with fleet.read() as unit:
        assert make.same(unit.tracks.layout("S-7", 2), replace(second, version=2))
        assert make.same(unit.tracks.layout("S-7"), replace(first, version=3))
        assert unit.tracks.layout_version("S-7") == 3
    with pytest.raises(NotFoundError), fleet.write() as unit:
        unit.tracks.add_layout(replace(first, section="S-8"))
