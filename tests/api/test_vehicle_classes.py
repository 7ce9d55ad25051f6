"""What the API says of vehicle classes: every parameter with its std and unit, by version."""

from __future__ import annotations

from dataclasses import replace

import api_fleet
import httpx
import pytest
from running_service import Service

from ingest.vehicle_class_schema import shipped_class, shipped_classes

COACH = replace(shipped_class("coach"), code="regional")


def test_a_vehicle_leads_to_its_class_with_value_std_and_unit_of_every_parameter(client: httpx.Client) -> None:
    vehicle = client.get("/v1/vehicles/V-0").json()
    found = client.get(vehicle["links"]["vehicle_class"]).json()
    assert (found["code"], found["version"], found["arrangement"]) == ("regional", 1, "bogie")
    by_name = {one["name"]: one for one in [*found["wheelset"], *found["bogie"]]}
    spring = by_name["yaw_stiffness"]
    assert (spring["value"], spring["unit"]) == (COACH.parameters.yaw_stiffness, "N m/rad")
    assert spring["std"] == pytest.approx(COACH.std_of("yaw_stiffness") * COACH.parameters.yaw_stiffness)
    assert by_name["wheelbase"]["unit"] == by_name["nominal_radius"]["unit"] == "m"
    assert by_name["lateral_spin_creep_coefficient"]["unit"] == "N m"
    assert {one["name"] for one in found["sensors"]["channels"]} == {"lateral", "yaw", "roll", "mass_lateral"}


def test_classes_of_the_package_are_listed_beside_those_registered(client: httpx.Client) -> None:
    items = client.get("/v1/vehicle-classes").json()["items"]
    versions = {one["code"]: one["version"] for one in items}
    assert versions.items() >= ({"regional": 1} | dict.fromkeys(shipped_classes())).items()
    assert client.get("/v1/vehicle-classes/paper").json()["recorded_at"] is None


def test_a_changed_class_is_a_new_version_and_the_old_one_stays(service: Service, client: httpx.Client) -> None:
    tram = replace(COACH, code="tram")
    stiffer = replace(tram, parameters=replace(tram.parameters, yaw_stiffness=70e6))
    with service.storage.write() as unit:
        unit.registry.add_vehicle_class(tram, api_fleet.RECORDED)
        unit.registry.add_vehicle_class(stiffer, api_fleet.RECORDED + 1)
    newest = client.get("/v1/vehicle-classes/tram").json()
    first = client.get("/v1/vehicle-classes/tram?version=1").json()
    assert (newest["version"], first["version"]) == (2, 1)
    assert newest["digest"] != first["digest"]
    assert client.get(first["links"]["as_recorded"]).json() == first
    assert client.get("/v1/vehicle-classes/tram?version=3").status_code == 404
    assert client.get("/v1/vehicle-classes/unheard").status_code == 404
