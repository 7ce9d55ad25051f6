"""The registry by REST: mounted, exchanged, turned, measured; what contradicts is refused with the records named."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import api_fleet
import httpx
import pytest
from one_database import in_turn
from populated_service import populated_service
from running_service import Service

from api.times import to_rfc3339
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.values.registry import Mounting, WheelsetRecord
from ingest.vehicle_class_schema import shipped_path

DAY = api_fleet.DAY
BEGIN = api_fleet.START + 20 * DAY


@pytest.fixture(scope="module", params=in_turn)
def service(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, postgres_server_url: str
) -> Iterator[Service]:
    """Yield a service of these tests alone."""
    with populated_service(request.param, tmp_path_factory.mktemp("data"), postgres_server_url) as found:
        yield found


def at(day: float) -> str:
    return to_rfc3339(BEGIN + round(day * DAY))


def tag_of(service: Service, path: str) -> str:
    found: str = service.client.get(path).headers["etag"]
    return found


def post(service: Service, path: str, body: dict[str, Any], of: str, **headers: str) -> httpx.Response:
    """Post under the present ETag of a resource."""
    named = {name.replace("_", "-"): value for name, value in headers.items()}
    return service.client.post(path, json=body, headers={"If-Match": tag_of(service, of)} | named)


@pytest.fixture
def pair(service: Service, request: pytest.FixtureRequest) -> tuple[str, str, str]:
    """Return a vehicle of its own with a mounted wheelset, and one in the store; each test has other ones."""
    name = f"R{abs(hash(request.node.name)) % 10**9}"
    vehicle, mounted, stored = f"V-{name}", f"A-{name}", f"B-{name}"
    with service.storage.write() as unit:
        unit.registry.add_vehicle(replace(unit.registry.vehicle("V-0"), code=vehicle, vehicle_class="unknown"))
        for serial in (mounted, stored):
            unit.registry.add_wheelset(WheelsetRecord(serial, "alpha", "P8", 0.46, None))
        unit.registry.add_mounting(Mounting(mounted, vehicle, 1, BEGIN, None, 80_000.0, 30_000.0))
        unit.stale_spans.remove(unit.stale_spans.all())
    return vehicle, mounted, stored


def test_a_wheelset_is_exchanged_in_one_call(service: Service, pair: tuple[str, str, str]) -> None:
    vehicle, mounted, stored = pair
    path = f"/v1/wheelsets/{mounted}"
    body = {
        "exchanged_at": at(10),
        "fitted": stored,
        "vehicle_odometer_km": 84_000.0,
        "fitted_mileage_km": 0.0,
        "why": "flat",
        "by": "ada",
    }
    tag = tag_of(service, path)
    refused = post(service, f"{path}/exchange", body | {"fitted": "WS-000"}, path)
    assert refused.status_code == 409
    assert refused.json()["contradicts"] == [{"kind": "mountings", "key": "WS-000", "at": to_rfc3339(api_fleet.START)}]
    assert tag_of(service, path) == tag  # neither
    done = post(service, f"{path}/exchange", body, path, Idempotency_Key=f"x{vehicle}")
    assert done.status_code == 201
    assert done.json()["removed"]["mounted_to"] == done.json()["fitted"]["mounted_from"] == at(10)
    again = service.client.post(
        f"{path}/exchange", json=body, headers={"If-Match": tag, "Idempotency-Key": f"x{vehicle}"}
    )
    assert (again.json(), again.headers["idempotency-replayed"]) == (done.json(), "true")
    assert service.client.get(path).json()["mounting"] is None
    assert service.client.get(f"/v1/wheelsets/{stored}").json()["mounting"] == done.json()["fitted"]
    with service.storage.read() as unit:
        assert {span.vehicle for span in unit.stale_spans.all(vehicle)} == {vehicle}  # windows are made again
        events = unit.registry_history.list(mounted)
    assert [(one.action, one.actor, one.reason) for one in events] == [("changed", "ada", "flat")]


def test_a_wheelset_is_taken_off_and_mounted_elsewhere(service: Service, pair: tuple[str, str, str]) -> None:
    vehicle, mounted, _ = pair
    path = f"/v1/wheelsets/{mounted}"
    early = post(service, f"{path}/dismount", {"dismounted_at": at(-1)}, path)
    assert (early.status_code, "only since" in early.json()["detail"]) == (409, True)
    assert post(service, f"{path}/dismount", {"dismounted_at": at(5)}, path).status_code == 201
    assert post(service, f"{path}/dismount", {"dismounted_at": at(6)}, path).status_code == 409
    body = {
        "vehicle": vehicle,
        "axle": 2,
        "mounted_from": at(7),
        "vehicle_odometer_km": 82_000.0,
        "wheelset_mileage_km": 32_000.0,
    }
    overlapping = post(service, f"{path}/mountings", body | {"mounted_from": at(4)}, path)
    assert overlapping.status_code == 409
    assert overlapping.json()["contradicts"] == [{"kind": "mountings", "key": mounted, "at": at(0)}]
    axle = post(service, f"{path}/mountings", body | {"axle": 5}, path)
    assert (axle.status_code, axle.json()["errors"][0]["pointer"]) == (422, "#/axle")
    lost = post(service, f"{path}/mountings", body | {"vehicle": "V-none"}, path)
    assert lost.status_code == 404
    metres = post(service, f"{path}/mountings", body | {"vehicle_odometer_km": 82_000_000.0}, path)
    assert metres.status_code == 409
    assert metres.json()["errors"][0] == {
        "in": "body",
        "pointer": "#/vehicle_odometer_km",
        "detail": (
            "82,000,000 km: the odometer would run faster than any vehicle (metres?), there is 80,000 km by the "
            f"mounting of wheelset {mounted!r} at {at(0)} (if it is so all the same, confirm odometer_jump)"
        ),
    }
    done = post(service, f"{path}/mountings", body, path)
    assert done.status_code == 201
    assert service.client.get(path).json()["mounting"] == done.json()
    same = post(service, f"{path}/mountings", body, path)
    assert (same.status_code, "from this time on file" in same.json()["detail"]) == (409, True)


def test_a_doubt_is_confirmed_in_the_request(service: Service, pair: tuple[str, str, str]) -> None:
    vehicle, mounted, _ = pair
    path = f"/v1/wheelsets/{mounted}"
    assert post(service, f"{path}/dismount", {"dismounted_at": at(5)}, path).status_code == 201
    body = {
        "vehicle": vehicle,
        "axle": 1,
        "mounted_from": at(6),
        "vehicle_odometer_km": 12.0,
        "wheelset_mileage_km": 32_000.0,
    }
    assert post(service, f"{path}/mountings", body, path).status_code == 409
    done = post(service, f"{path}/mountings", body | {"confirm": ["odometer_backwards"]}, path)
    assert done.status_code == 201
    hard = post(
        service, f"{path}/reprofilings", {"reprofiled_at": at(7), "mileage_km": 1.0, "confirm": ["future"]}, path
    )
    assert hard.status_code == 422


@pytest.mark.parametrize(
    ("body", "status", "pointer", "kind"),
    [
        ({"reprofiled_at": "2036-01-01T00:00:00Z", "mileage_km": 40_000.0}, 422, "#/reprofiled_at", None),
        ({"reprofiled_at": at(-1), "mileage_km": 30_000.0}, 409, "#/reprofiled_at", "mountings"),
        ({"reprofiled_at": at(30), "mileage_km": 1000.0}, 409, "#/mileage_km", "mountings"),
        ({"reprofiled_at": at(30), "mileage_km": 9e7}, 409, "#/mileage_km", "mountings"),
    ],
)
def test_a_reprofiling_that_contradicts_is_refused(
    service: Service, pair: tuple[str, str, str], body: dict[str, Any], status: int, pointer: str, kind: str | None
) -> None:
    path = f"/v1/wheelsets/{pair[1]}"
    answer = post(service, f"{path}/reprofilings", body, path)
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (status, pointer)
    assert [one["kind"] for one in answer.json().get("contradicts", [])] == [kind] * (kind is not None)
    assert service.client.get(path).json()["reprofilings"] == []


def miniprof(points: Any, *, upwards: bool = True) -> str:  # noqa: ANN401 - a profile
    sign = -1000.0 if upwards else 1000.0
    rows = [f"{1000.0 * y:.4f} {sign * z:.4f}" for y, z in zip(points.y[::10], points.z[::10], strict=True)]
    return "\n".join(["ProgramName=MiniProf", "ColumnDef=X,Y", "", *rows])


def test_both_wheels_are_uploaded_in_one_call(service: Service, pair: tuple[str, str, str]) -> None:
    path = f"/v1/wheelsets/{pair[1]}"
    wheel = {"file_name": "left.whl", "text": miniprof(wheel_profile("P8"))}
    body = {"measured_at": at(3), "mileage_km": 31_000.0, "left": wheel, "right": wheel | {"file_name": "right.whl"}}
    rail = {"file_name": "rail.whl", "text": miniprof(rail_profile("60E1"))}
    refused = post(service, f"{path}/measured-profiles", body | {"right": rail}, path)
    assert refused.status_code == 422
    assert refused.json()["errors"] == [
        {
            "in": "body",
            "pointer": "#/right/text",
            "detail": "rail.whl: is the profile of a rail; that of a wheel is needed",
        }
    ]
    for text in ("", "\x00", "no profile", "0 0\n" * 40):
        assert (
            post(service, f"{path}/measured-profiles", body | {"left": wheel | {"text": text}}, path).status_code == 422
        )
    future = post(service, f"{path}/measured-profiles", body | {"measured_at": "2036-01-01T00:00:00Z"}, path)
    assert (future.status_code, future.json()["errors"][0]["pointer"]) == (422, "#/measured_at")
    done = post(service, f"{path}/measured-profiles", body, path)
    assert done.status_code == 201
    assert (done.json()["left"], done.json()["right"], done.json()["std_mm"]) == ("left", "right", 0.1)
    assert service.client.get(f"{path}/measured-profiles").json()["items"] == [done.json()]
    same = post(service, f"{path}/measured-profiles", body, path)
    assert same.status_code == 409
    with service.storage.read() as unit:
        (stored,) = unit.registry.measured_profiles(pair[1])
    assert abs(stored.left.y[0] - wheel_profile("P8").y[0]) < 1e-3


def test_more_than_the_limit_is_413(service: Service, pair: tuple[str, str, str]) -> None:
    path = f"/v1/wheelsets/{pair[1]}"
    wheel = {"file_name": "left.whl", "text": "x" * (10 << 20)}
    body = {"measured_at": at(3), "mileage_km": 31_000.0, "left": wheel, "right": wheel}
    assert post(service, f"{path}/measured-profiles", body, path).status_code == 413


VEHICLE = {
    "fleet": "alpha",
    "vehicle_class": "coach",
    "axles": 2,
    "max_speed_km_h": 160.0,
    "axle_offsets_m": [2.0, 4.56],
}


def test_vehicles_wheelsets_and_classes_are_entered_and_changed(service: Service, pair: tuple[str, str, str]) -> None:
    code, serial = f"N-{pair[0]}", f"NW-{pair[1]}"
    new = service.client.post("/v1/vehicles", json=VEHICLE | {"code": code})
    assert (new.status_code, new.json()["max_speed_km_h"]) == (201, 160.0)
    assert service.client.get(f"/v1/vehicles/{code}").json() == new.json()
    assert service.client.post("/v1/vehicles", json=VEHICLE | {"code": code}).status_code == 409
    for wrong, field in (
        ({"code": f"{code}__1"}, "code"),
        ({"code": "A/B"}, "code"),
        ({"axle_offsets_m": [2.0]}, "axle_offsets_m"),
        ({"axle_offsets_m": [2.0, 4.9]}, "axle_offsets_m"),
        ({"axles": 9}, "axles"),
    ):
        refused = service.client.post("/v1/vehicles", json=VEHICLE | {"code": f"{code}x"} | wrong)
        assert (refused.status_code, refused.json()["errors"][0]["pointer"]) == (422, f"#/{field}")
    assert service.client.post("/v1/vehicles", json=VEHICLE | {"code": "V", "fleet": "none"}).status_code == 404
    path = f"/v1/vehicles/{code}"
    assert service.client.put(path, json=VEHICLE).status_code == 428
    faster = VEHICLE | {"max_speed_km_h": 180.0}
    assert service.client.put(path, json=faster, headers={"If-Match": '"old"'}).status_code == 412
    changed = service.client.put(path, json=faster, headers={"If-Match": tag_of(service, path)})
    assert (changed.status_code, changed.json()["max_speed_km_h"]) == (200, 180.0)
    wheelset = {"serial": serial, "fleet": "alpha", "wheel_profile": "S1002", "nominal_radius_mm": 920.0}
    refused = service.client.post("/v1/wheelsets", json=wheelset)
    assert (refused.status_code, "a diameter?" in refused.json()["detail"]) == (422, True)
    made = service.client.post("/v1/wheelsets", json=wheelset | {"nominal_radius_mm": 460.0})
    assert made.status_code == 201
    path = f"/v1/wheelsets/{serial}"
    body = {"fleet": "alpha", "wheel_profile": "P8", "nominal_radius_mm": 461.0}
    put = service.client.put(path, json=body, headers={"If-Match": tag_of(service, path)})
    assert (put.status_code, put.json()["wheel_profile"], put.json()["nominal_radius_mm"]) == (200, "P8", 461.0)
    text = shipped_path("coach").read_text(encoding="utf-8").replace('code = "coach"', f'code = "{code}"', 1)
    cls = service.client.post("/v1/vehicle-classes", json={"text": text})
    assert (cls.status_code, cls.json()["version"]) == (201, 1)
    assert service.client.post("/v1/vehicle-classes", json={"text": text}).json() == cls.json()
    wrong = service.client.post("/v1/vehicle-classes", json={"text": text.replace("mass_kg", "mas_kg", 1)})
    assert (wrong.status_code, wrong.json()["errors"][0]["pointer"]) == (422, "#/text")


def test_work_on_sensors_is_recorded(service: Service, pair: tuple[str, str, str]) -> None:
    path = f"/v1/vehicles/{pair[0]}"
    body = {"axle": 1, "worked_at": at(4), "work": "swap", "removed": "N-1", "fitted": "N-2"}
    done = post(service, f"{path}/sensor-changes", body, path)
    assert done.status_code == 201
    assert service.client.get(f"{path}/sensor-changes").json()["items"] == [done.json()]
    assert post(service, f"{path}/sensor-changes", body, path).status_code == 409
    axle = post(service, f"{path}/sensor-changes", body | {"axle": 6, "worked_at": at(5)}, path)
    assert (axle.status_code, axle.json()["errors"][0]["pointer"]) == (422, "#/axle")
    future = post(service, f"{path}/sensor-changes", body | {"worked_at": "2036-01-01T00:00:00Z"}, path)
    assert (future.status_code, future.json()["errors"][0]["pointer"]) == (422, "#/worked_at")


def test_a_wrong_reprofiling_is_voided_and_restored_with_its_history(
    service: Service, pair: tuple[str, str, str]
) -> None:
    serial = pair[1]
    path = f"/v1/wheelsets/{serial}"
    turned = post(service, f"{path}/reprofilings", {"reprofiled_at": at(9), "mileage_km": 33_000.0, "by": "bob"}, path)
    body = {"kind": "reprofiling", "key": serial, "at": at(9), "reason": "was another wheelset", "by": "ada"}
    assert service.client.post("/v1/registry/void", json=body).status_code == 428
    assert service.client.post("/v1/registry/void", json=body, headers={"If-Match": '"x"'}).status_code == 412
    assert post(service, "/v1/registry/void", body | {"at": None}, path).status_code == 422
    assert post(service, "/v1/registry/void", body | {"at": at(8)}, path).status_code == 404
    tag = tag_of(service, path)
    voided = post(service, "/v1/registry/void", body, path, Idempotency_Key=f"v{serial}")
    assert (voided.status_code, voided.json()["before"], voided.json()["after"]) == (201, turned.json(), None)
    assert service.client.get(path).json()["reprofilings"] == []
    replayed = service.client.post(
        "/v1/registry/void", json=body, headers={"If-Match": tag, "Idempotency-Key": f"v{serial}"}
    )
    assert replayed.json() == voided.json()
    restored = post(service, "/v1/registry/restore", body | {"reason": "it was right"}, path)
    assert (restored.status_code, restored.json()["after"]) == (201, turned.json())
    assert service.client.get(path).json()["reprofilings"] == [turned.json()]
    history = service.client.get("/v1/registry/history", params={"of": serial, "kind": "reprofiling"}).json()["items"]
    assert [(one["action"], one["by"], one["reason"]) for one in history] == [
        ("entered", "bob", ""),
        ("voided", "ada", "was another wheelset"),
        ("restored", "ada", "it was right"),
    ]
    page = service.client.get("/v1/registry/history", params={"of": serial, "limit": 1}).json()
    assert page["next_cursor"]
    assert service.client.get("/v1/registry/history", params={"kind": "other"}).status_code == 422


def test_what_contradicts_newer_records_is_not_restored(service: Service, pair: tuple[str, str, str]) -> None:
    path, serial = f"/v1/wheelsets/{pair[1]}", pair[1]
    first = {"reprofiled_at": at(9), "mileage_km": 33_000.0}
    post(service, f"{path}/reprofilings", first, path)
    body = {"kind": "reprofiling", "key": serial, "at": at(9), "reason": "wrong"}
    assert post(service, "/v1/registry/void", body, path).status_code == 201
    post(service, f"{path}/reprofilings", {"reprofiled_at": at(10), "mileage_km": 31_000.0}, path)
    refused = post(service, "/v1/registry/restore", body, path)
    assert refused.status_code == 409
    assert refused.json()["contradicts"] == [{"kind": "reprofilings", "key": serial, "at": at(10)}]
