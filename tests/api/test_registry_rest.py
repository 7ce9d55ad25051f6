"""The registry by REST: mounted, exchanged, turned, measured; what contradicts is refused with the records named."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import api_fleet
import httpx
import pytest
from running_service import Service

from api.times import to_rfc3339
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.values.registry import Mounting, WheelsetRecord

DAY = api_fleet.DAY
BEGIN = api_fleet.START + 20 * DAY


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
