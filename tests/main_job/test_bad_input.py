"""Bad input from frames and files to the REST API: refused or reported with its reason; no other result moves."""

from __future__ import annotations

import asyncio
import csv
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
from bad_recordings import JUMPING, STANDING, WRONG, Edited, edited, registry_with
from tiny_fleet import Deployment, deployment, recorded_once

from api.demo.findings import ServiceAddress, track_lines
from api.serving import create_app
from api.terminal.demo import free_port, serving_api
from api.terminal.estimate import fleet_reasons, summary_lines
from ingest.simulator.fleet import FleetReport, Recording
from ingest.simulator.scenario_file import load_scenario

HEAD = """\
name = "bad"
description = "two vehicles of two wheelsets over a surveyed section"
seed = 5
[fleet]
code = "U"
name = "Fleet"
[dynamics]
load = 12263.0

[section]
code = "U-1"
number = 1
name = "Section"
length_m = 2600.0
survey_alignment_std_mm = 0.05
[speed]
lowest_m_s = 17.0
highest_m_s = 22.0
[sessions]
start = 2024-01-08T05:30:00Z
campaigns = 4
minutes_each = 1.55
first_odometer_km = 1000.0
km_between = 1500.0
start_within_m = 100.0
"""
VEHICLE = """
[[vehicles]]
code = "{code}"
class = "railcar"
max_speed_km_h = 120.0
axle_offsets_m = [2.0, 4.5]
"""
WHEELSET = """
[[vehicles.wheelsets]]
serial = "{serial}"
initial_wear_mm = {wear}
initial_mileage_km = 100000.0
wear_mm_per_100000_km = 0.05
"""
WEAR = {"U-A": (0.1, 1.0), "U-B": (1.4, 0.3)}
SERIALS = [f"{code}{axle}" for code in WEAR for axle in (1, 2)]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> FleetReport:
    text = HEAD
    for code, depths in WEAR.items():
        text += VEHICLE.format(code=code)
        text += "".join(WHEELSET.format(serial=f"{code}{axle}", wear=d) for axle, d in enumerate(depths, start=1))
    path = tmp_path_factory.mktemp("scenario") / "bad.toml"
    path.write_text(text)
    return recorded_once(tmp_path_factory, load_scenario(path))


Deploy = Callable[[Path], Deployment]


@pytest.fixture
def deploy(migrated_sqlite_file: Path, tmp_path: Path, report: FleetReport) -> Iterator[Deploy]:
    """Return what makes a deployment with a registry."""
    made: list[Deployment] = []

    def deployed(registry: Path) -> Deployment:
        name = f"{len(made)}"
        shutil.copyfile(migrated_sqlite_file, tmp_path / f"{name}.sqlite3")
        url = f"sqlite:///{tmp_path / name}.sqlite3"
        made.append(deployment(url, tmp_path / name, replace(report, registry=registry)))
        return made[-1]

    yield deployed
    for one in made:
        one.storage.close()


def asked(found: Deployment, path: str) -> Any:  # noqa: ANN401 - JSON
    app = create_app(found.settings)

    async def get() -> httpx.Response:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://treadwatch") as client:
            return await client.get(path)

    answer = asyncio.run(get())
    assert answer.status_code == 200, (path, answer.text)
    return answer.json()


def geometries(found: Deployment) -> dict[str, Any]:
    """Return the valid wheelsets' geometry as the API serves it, without its time and its version of the track."""
    document = {}
    for serial in SERIALS:
        full = asked(found, f"/v1/wheelsets/{serial}/geometry")
        document[serial] = {k: v for k, v in full.items() if k not in {"recorded_at", "provenance", "links"}}
    return document


def first_campaign(report: FleetReport) -> list[Recording]:
    return [one for one in report.recordings if one.campaign == 1]


def received(found: Deployment, *recordings: Sequence[Recording | Edited]) -> None:
    found.campaign_over([one for some in recordings for one in some])  # type: ignore[misc] - path and vehicle are all
    found.run_jobs()


@pytest.fixture(scope="module")
def on_unknown_track(
    migrated_sqlite_file: Path, tmp_path_factory: pytest.TempPathFactory, report: FleetReport
) -> dict[str, Any]:
    """Return the geometries of the sound recordings of one campaign alone, whose track is not on file."""
    folder = tmp_path_factory.mktemp("unknown")
    registry = registry_with(report.registry, folder / "registry", {}, surveyed=False)
    shutil.copyfile(migrated_sqlite_file, folder / "0.sqlite3")
    found = deployment(f"sqlite:///{folder}/0.sqlite3", folder / "0", replace(report, registry=registry))
    try:
        received(found, first_campaign(report))
        return geometries(found)
    finally:
        found.storage.close()


@pytest.mark.slow
def test_bad_recordings_are_refused_by_name_and_the_others_stay_as_they_were(
    deploy: Deploy, report: FleetReport, tmp_path: Path
) -> None:
    valid = first_campaign(report)
    source = valid[0]
    alone = deploy(registry_with(report.registry, tmp_path / "alone", {}, surveyed=False))
    received(alone, valid)
    vehicles = dict.fromkeys([*WRONG, STANDING[0], JUMPING[0]], source.vehicle)
    among = deploy(registry_with(report.registry, tmp_path / "among", vehicles, surveyed=False))
    received(among, [edited(source.path, name, change, tmp_path) for name, (change, _) in WRONG.items()], valid)
    (stood,) = among.receive([edited(source.path, *STANDING, tmp_path)])  # type: ignore[list-item] - path and vehicle are all
    assert (stood.counts["windows"], stood.counts["windows_standing"]) == (0, 6)  # parked trains fill no store
    for name, (_, code) in WRONG.items():
        for axle in (1, 2):
            windows = asked(among, f"/v1/wheelsets/{name}-{axle}/windows")["items"]
            assert windows
            assert {one["state"] for one in windows} == {"refused"}, windows
            assert {one["reason_code"] for one in windows} == {code}, (name, [one["reason"] for one in windows])
    assert geometries(among) == geometries(alone)
    _then_one_jumps(among, [edited(source.path, *JUMPING, tmp_path)])


def _then_one_jumps(among: Deployment, jumping: Sequence[Edited]) -> None:
    before = geometries(among)
    received(among, jumping)
    windows = asked(among, f"/v1/wheelsets/{JUMPING[0]}-1/windows")["items"]
    assert [one["state"] for one in windows][1:] == ["refused", "estimated"]  # the first runs onto the known part
    assert "the position jumps once against the speed, by 30.0 m" in windows[1]["reason"]
    for serial, now in geometries(among).items():
        first, second = before[serial]["equivalent_conicity_1"], now["equivalent_conicity_1"]
        assert second["status"] in {first["status"], "estimated"}, serial  # its sound windows place more of the others
        if first["value"] is not None:
            assert abs(first["value"] - second["value"]) < 2.0 * first["std"]


Spoil = Callable[[float, float], tuple[float, float]]


@pytest.mark.slow
def test_a_track_file_that_the_fleet_contradicts_is_not_used_and_the_api_says_why(
    deploy: Deploy, report: FleetReport, tmp_path: Path, on_unknown_track: dict[str, Any]
) -> None:
    """Left is right in the file; other mistakes are tried by the jobs alone (``test_bad_input_jobs.py``)."""
    registry = registry_with(report.registry, tmp_path / "spoilt", {}, surveyed=True)
    (file,) = registry.parent.glob("*.csv")
    head, *rows = csv.reader(file.read_text(encoding="utf-8").splitlines())
    lines = [",".join(head)]
    for s, d, *rest in rows:
        lines.append(",".join([s, f"{-float(d):.6f}", *rest]))
    file.write_text("\n".join(lines), encoding="utf-8")
    found = deploy(registry)
    received(found, first_campaign(report))
    document = asked(found, "/v1/track-sections/U-1/alignment-report")
    assert document["recording"].startswith("not used: ")
    assert "mirror image" in document["recording"]
    assert document["recording_code"] == "survey_mirrored"
    assert track_of(found).startswith(
        "the surveyed alignment is not used; the fleet has found its alignment, now version 2"
    )
    versions = asked(found, "/v1/track-sections/U-1/alignments")["items"]
    assert [(one["version"], one["source"]) for one in versions] == [(1, "recorded"), (2, "fleet")]
    assert geometries(found) == on_unknown_track


@pytest.mark.slow
def test_two_swapped_vehicles_wheelsets_are_reported_and_kept_apart(
    deploy: Deploy, report: FleetReport, tmp_path: Path
) -> None:
    """From the third campaign on each vehicle runs on the other's bogie; the registry does not know."""
    found = deploy(registry_with(report.registry, tmp_path / "swapped", {}, surveyed=False))
    other = {"U-A": "U-B", "U-B": "U-A"}
    for campaign in (1, 2, 3, 4):
        these = [one for one in report.recordings if one.campaign == campaign]
        if campaign > 2:
            these = [replace(one, vehicle=other[one.vehicle]) for one in these]
        received(found, these)
    found.run_jobs()  # trends begin after the change that the alerts name
    alerts = [one for one in asked(found, "/v1/alerts?open=true")["items"] if one["kind"] == "identity"]
    partners = {one["wheelset"]: one["evidence"]["partner"] for one in alerts}
    assert partners == {"U-A1": "U-B1", "U-B1": "U-A1", "U-A2": "U-B2", "U-B2": "U-A2"}
    assert all(one["action"] == "check_mounting" for one in alerts)
    assert all("has become that of another wheelset" in one["evidence"]["reason"] for one in alerts)
    for serial in SERIALS:
        points = asked(found, f"/v1/wheelsets/{serial}/trend")["points"]
        assert min(points["measured_at"]) > "2024-01-15"  # of the third campaign


def test_a_section_that_too_few_have_passed_says_so_and_nothing_is_estimated(
    deploy: Deploy, report: FleetReport, tmp_path: Path
) -> None:
    found = deploy(registry_with(report.registry, tmp_path / "few", {}, surveyed=False))
    received(found, first_campaign(report)[:1])
    document = asked(found, "/v1/track-sections/U-1/alignment-report")
    assert (document["status"], document["version"], document["made_version"]) == ("unestimated", None, False)
    assert document["reason_code"] == "too_few_passes"
    assert document["alignment_std_mm"] is None
    assert asked(found, "/v1/track-sections/U-1/alignments")["items"] == []
    windows = asked(found, "/v1/wheelsets/U-A1/windows")["items"]
    assert {one["state"] for one in windows} == {"refused"}
    assert {one["reason_code"] for one in windows} == {"alignment_unknown"}
    few = "no place with 3 passes: 2 at most, 1 to go"
    assert track_of(found) == f"not surveyed, and the fleet has not estimated its alignment yet: {few}"
    for name in ("geometry", "trend"):
        answer = asked(found, f"/v1/wheelsets/U-A1/{name}")
        (refused,) = answer["unestimated_because"]["reasons"]
        assert (answer["status"], refused["windows"]) == ("unestimated", len(windows))
        assert refused["reason"] == f"the alignment of section U-1 is not known yet: {few}"
        assert refused["what_to_do"] == "Survey it, or wait for more passes."
    with found.storage.read() as unit:
        lines = summary_lines(fleet_reasons(unit))
    assert f" refused alignment_unknown: the alignment of section U-1 is not known yet: {few}. Survey it" in lines[1]


def track_of(found: Deployment) -> str:
    """Return what the demo would say of the section, behind its name."""
    with serving_api(found.settings.model_copy(update={"port": free_port("127.0.0.1", 0)})) as url:
        (said,) = track_lines(ServiceAddress(url, None))
    return said.split(": ", 1)[1]
