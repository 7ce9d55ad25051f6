"""What does not belong together, through the job: refused with its reason, and no friction and no alert from it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import httpx
import numpy as np
import pytest
from adhesion_fleet import EstimatedFleet

from api.comparison.trial import copied, opened, run_jobs
from api.serving import create_app
from api.settings import Settings
from estimation.jobs import refresh_adhesion
from estimation.jobs.job import JobContext
from estimation.values.opinions import WindowAdhesion
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.registry import FleetRecord
from estimation.values.windows import Window, WindowRecord, WindowState
from fleet_db.storage import SqlStorage, SqlUnitOfWork

Change = Callable[[SqlUnitOfWork], None]


@contextmanager
def fleet_with(fleet: EstimatedFleet, folder: Path, change: Change) -> Iterator[tuple[SqlStorage, JobContext]]:
    """Yield a copy of the fleet whose store was changed, and whose adhesion was refreshed then."""
    settings = copied(fleet.settings, folder / "copy")
    with opened(settings) as (storage, context):
        with storage.write() as unit:
            change(unit)
        run_jobs(context, [refresh_adhesion.JOB])
        yield storage, context


def estimated(unit: SqlUnitOfWork) -> list[WindowRecord]:
    found = [record for one in unit.registry.wheelsets() for record in unit.windows.list(one.serial)]
    return [record for record in found if record.state is WindowState.ESTIMATED]


def replaced(unit: SqlUnitOfWork, record: WindowRecord, change: Callable[[Window], Window]) -> None:
    """Give a window other samples, which the estimator has taken."""
    unit.windows.put(change(unit.windows.samples(record)), record.mileage_km, 1)
    unit.windows.mark(record.wheelset, record.start_ns, WindowState.ESTIMATED)


def of(storage: SqlStorage, records: Sequence[WindowRecord]) -> list[WindowAdhesion | None]:
    with storage.read() as unit:
        return [next(iter(unit.adhesion.of_wheelset(one.wheelset, one.start_ns - 1, 1)), None) for one in records]


def passed(unit: SqlUnitOfWork, section: str) -> Sequence[WindowAdhesion]:
    return unit.adhesion.of_section(section, 0, 2**62)


def reversed_node(window: Window) -> Window:
    return replace(window, mass_lateral_acceleration=-window.mass_lateral_acceleration)


def noisy_node(window: Window) -> Window:
    noise = 3.0 * np.random.default_rng(1).standard_normal(len(window.valid))
    return replace(window, lateral_acceleration=window.lateral_acceleration + noise)


@pytest.mark.parametrize("broken", [reversed_node, noisy_node])
def test_a_node_that_does_not_fit_gives_nothing_to_its_bogie_and_the_others_give_friction(
    estimated_fleet: EstimatedFleet, tmp_path: Path, broken: Callable[[Window], Window]
) -> None:
    bogie: list[WindowRecord] = []
    others: list[WindowRecord] = []

    def change(unit: SqlUnitOfWork) -> None:
        for record in estimated(unit):
            (bogie if record.vehicle == "V0" and record.axle <= 2 else others).append(record)
        for record in bogie:
            if record.axle == 1:
                replaced(unit, record, broken)

    with fleet_with(estimated_fleet, tmp_path, change) as (storage, _):
        found = of(storage, bogie)
        assert found
        for one in found:
            assert one is not None
            assert one.sums is None
            assert one.reason is not None
            assert one.reason.code in {ReasonCode.DIVERGED, ReasonCode.AXLE_DISTANCE}
            assert one.yaw_creep.value is None
            if one.reason.code is ReasonCode.DIVERGED:
                assert one.status is Status.MODEL_MISMATCH
        with storage.read() as unit:
            section = unit.adhesion.section(estimated_fleet.scenario.section.code)
        assert section is not None
        assert section.windows == len(others)


def test_profiles_without_a_shape_leave_forces_and_no_friction(estimated_fleet: EstimatedFleet, tmp_path: Path) -> None:
    def change(unit: SqlUnitOfWork) -> None:
        code = estimated_fleet.scenario.section.code
        section = next(one for one in unit.tracks.sections() if one.code == code)
        records = estimated(unit)
        unit.tracks.add_section(replace(section, rail_profile="of the works"))
        for record in records:
            unit.windows.mark(record.wheelset, record.start_ns, WindowState.ESTIMATED)

    with fleet_with(estimated_fleet, tmp_path, change) as (storage, _):
        with storage.read() as unit:
            records = estimated(unit)
            assert unit.adhesion.section(estimated_fleet.scenario.section.code) is None
            assert len(unit.alerts.feed(0, 100)) == 0
        for one in of(storage, records):
            assert one is not None
            assert one.reason is not None
            assert one.reason.code is ReasonCode.PROFILES_UNKNOWN
            assert one.yaw_creep.value is not None
            assert one.lateral_creep.value is None
            assert one.sums is None


def test_windows_that_leave_the_section_leave_its_friction(estimated_fleet: EstimatedFleet, tmp_path: Path) -> None:
    """They lose their position, or are assembled again of other samples."""
    code = estimated_fleet.scenario.section.code
    with fleet_with(estimated_fleet, tmp_path, lambda _: None) as (storage, context):
        with storage.write() as unit:
            records = unit.windows.several([one.key for one in passed(unit, code) if one.vehicle == "V0"])
            before = len(passed(unit, code))
            for record in records:
                replaced(unit, record, lambda window: replace(window, track_section=None))
            assert len(passed(unit, code)) == before - len(records) > 0
        run_jobs(context, [refresh_adhesion.JOB])
        with storage.read() as unit:
            assert {one.vehicle for one in passed(unit, code)} == {"V1"}


def test_alerts_go_to_the_fleets_that_passed_alone(estimated_fleet: EstimatedFleet, tmp_path: Path) -> None:
    def change(unit: SqlUnitOfWork) -> None:
        for code in ("SECOND", "IDLE"):
            unit.registry.add_fleet(FleetRecord(code, code))
        unit.registry.add_vehicle(replace(unit.registry.vehicle("V1"), fleet="SECOND"))
        for record in [record for one in unit.registry.wheelsets() for record in unit.windows.list(one.serial)]:
            if record.reason is None:
                unit.windows.mark(record.wheelset, record.start_ns, WindowState.ESTIMATED)

    code = estimated_fleet.scenario.section.code
    with fleet_with(estimated_fleet, tmp_path, change) as (storage, _), storage.read() as unit:
        alerts = unit.alerts.open_of_section(code, "low_adhesion")
        assert sorted(alert.fleet for alert in alerts) == sorted([estimated_fleet.scenario.fleet_code, "SECOND"])


def test_hours_that_come_in_late_change_no_alert(estimated_fleet: EstimatedFleet, tmp_path: Path) -> None:
    """The windows of a day are looked at first, those of the day before later."""
    code, day = estimated_fleet.scenario.section.code, 24 * 3_600_000_000_000
    late: list[WindowRecord] = []

    def change(unit: SqlUnitOfWork) -> None:
        late.extend(estimated(unit))
        for record in late:
            window = unit.windows.samples(record)
            unit.windows.put(replace(window, start_ns=window.start_ns + day), record.mileage_km, 1)
            unit.windows.mark(record.wheelset, window.start_ns + day, WindowState.ESTIMATED)
            unit.windows.mark(record.wheelset, record.start_ns, WindowState.PENDING)

    with fleet_with(estimated_fleet, tmp_path, change) as (storage, context):
        with storage.write() as unit:
            (raised,) = unit.alerts.open_of_section(code, "low_adhesion")
            newest = unit.adhesion.section(code)
            for record in late:
                unit.windows.mark(record.wheelset, record.start_ns, WindowState.ESTIMATED)
        run_jobs(context, [refresh_adhesion.JOB])
        with storage.read() as unit:
            assert unit.alerts.open_of_section(code, "low_adhesion") == [raised]
            assert unit.adhesion.section(code) == newest
            assert newest is not None
            before = unit.adhesion.section(code, late[0].start_ns)
            assert before is not None
            assert before.to_ns < newest.from_ns
            # the edge of a stretch is where its probability passes a limit: one place of 50 m may be on either side
            np.testing.assert_allclose(before.low_stretches, newest.low_stretches, atol=50.0)


def test_a_section_that_nobody_passed_has_none(estimated_fleet: EstimatedFleet, tmp_path: Path) -> None:
    settings: Settings = copied(estimated_fleet.settings, tmp_path / "copy")
    with opened(settings) as (storage, context):
        with storage.write() as unit:
            section = unit.tracks.sections()[0]
            unit.tracks.add_section(replace(section, code="Q", number=99, name="Quiet"))
        run_jobs(context, [refresh_adhesion.JOB])
        with storage.read() as unit:
            assert unit.adhesion.section("Q") is None
    app = create_app(settings)

    async def get() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://treadwatch") as client:
            return await client.get("/v1/track-sections/Q/adhesion")

    answer = asyncio.run(get())
    assert answer.status_code == 404
    assert "adhesion yet of track section" in answer.text


def dead_node(window: Window) -> Window:
    """Return a window whose node of the frame sends zeros."""
    zeros = np.zeros_like(window.mass_lateral_acceleration)
    return replace(window, mass_lateral_acceleration=zeros)


def silent_node(window: Window) -> Window:
    """Return a window whose node of the frame sends nothing."""
    nothing = np.full_like(window.mass_lateral_acceleration, np.nan)
    return replace(window, mass_lateral_acceleration=nothing, valid=np.zeros_like(window.valid))


def of_first_bogie(unit: SqlUnitOfWork) -> tuple[list[WindowRecord], list[WindowRecord]]:
    found = estimated(unit)
    bogie = [record for record in found if record.vehicle == "V0" and record.axle <= 2]
    return bogie, [record for record in found if record not in bogie]


def holds_no_number(found: Sequence[WindowAdhesion | None], codes: set[ReasonCode]) -> None:
    """Assert that every window was looked at, and gave a reason and nothing else."""
    assert found
    for one in found:
        assert one is not None
        assert one.reason is not None
        assert one.reason.code in codes, one.reason
        assert one.sums is None
        numbers = (one.contact_force, one.lateral_creep, one.yaw_creep, one.used_adhesion)
        assert [number.value for number in numbers] == [None] * 4


def others_go_on(storage: SqlStorage, section: str, others: Sequence[WindowRecord]) -> None:
    """Assert that the others have their friction, and that nothing is in quarantine."""
    with storage.read() as unit:
        found = unit.adhesion.section(section)
        assert found is not None
        assert found.windows == len(others)
        assert not list(unit.quarantine.held(refresh_adhesion.JOB_NAME))


@pytest.mark.parametrize("broken", [dead_node, silent_node])
def test_a_dead_node_gives_a_reason_and_stops_nobody(
    estimated_fleet: EstimatedFleet, tmp_path: Path, broken: Callable[[Window], Window]
) -> None:
    bogie: list[WindowRecord] = []
    others: list[WindowRecord] = []

    def change(unit: SqlUnitOfWork) -> None:
        for records, found in zip((bogie, others), of_first_bogie(unit), strict=True):
            records.extend(found)
        for record in bogie:
            if record.axle == 1:
                replaced(unit, record, broken)

    with fleet_with(estimated_fleet, tmp_path, change) as (storage, _):
        codes = {ReasonCode.FRAME_UNKNOWN, ReasonCode.NO_USABLE_SAMPLE, ReasonCode.TOO_FEW_USABLE}
        holds_no_number(of(storage, bogie), codes)
        others_go_on(storage, estimated_fleet.scenario.section.code, others)


def test_a_vehicle_without_class_parameters_gives_a_reason_and_stops_nobody(
    estimated_fleet: EstimatedFleet, tmp_path: Path
) -> None:
    own: list[WindowRecord] = []
    others: list[WindowRecord] = []

    def change(unit: SqlUnitOfWork) -> None:
        for record in estimated(unit):
            (own if record.vehicle == "V0" else others).append(record)
        unit.registry.add_vehicle(replace(unit.registry.vehicle("V0"), vehicle_class="nobody knows"))
        for record in (*own, *others):
            unit.windows.mark(record.wheelset, record.start_ns, WindowState.ESTIMATED)

    with fleet_with(estimated_fleet, tmp_path, change) as (storage, _):
        holds_no_number(of(storage, own), {ReasonCode.CLASS_UNKNOWN})
        others_go_on(storage, estimated_fleet.scenario.section.code, others)
        with storage.read() as unit:
            assert list(unit.dampers.of_vehicles(["V0"])) == []


def at_other_axles(unit: SqlUnitOfWork) -> None:
    """File that the axles of the first vehicle, with their nodes, are as far apart as they are not."""
    vehicle = unit.registry.vehicle("V0")
    offsets = tuple(at + (0.9 if number % 2 else 0.0) for number, at in enumerate(vehicle.axle_offsets_m))
    unit.registry.add_vehicle(replace(vehicle, axle_offsets_m=offsets))


def test_a_vehicle_whose_nodes_sit_elsewhere_gives_a_reason_and_stops_nobody(
    estimated_fleet: EstimatedFleet, tmp_path: Path
) -> None:
    own: list[WindowRecord] = []
    others: list[WindowRecord] = []

    def change(unit: SqlUnitOfWork) -> None:
        for record in estimated(unit):
            (own if record.vehicle == "V0" else others).append(record)
        at_other_axles(unit)
        for record in (*own, *others):
            unit.windows.mark(record.wheelset, record.start_ns, WindowState.ESTIMATED)

    with fleet_with(estimated_fleet, tmp_path, change) as (storage, _):
        holds_no_number(of(storage, own), {ReasonCode.AXLE_DISTANCE})
        others_go_on(storage, estimated_fleet.scenario.section.code, others)
