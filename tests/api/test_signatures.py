"""What the service says of a wheelset by its signatures, beside its geometry and never in its place."""

from __future__ import annotations

import api_fleet
import httpx
from running_service import Service

from api.routes.opinions import signature_answer

PATH = "/v1/wheelsets/WS-000/signature"


def test_signature_and_geometry_stand_beside_each_other(client: httpx.Client) -> None:
    found = client.get(PATH).json()
    assert found["method"] == "signature"
    assert found["equivalent_conicity_at_3_mm_1"]["value"] == 0.3125
    assert found["geometry_at_3_mm_1"]["value"] == 0.25
    assert found["compared"] == {
        "difference_1": 0.0625,
        "difference_std_1": 0.0125,
        "disagree": True,
        "reason": "their intervals are apart",
        "reason_code": "methods_disagree",
    }
    assert found["state"] == {"from_1": 0.25, "to_1": None, "probability": 0.875}
    assert [one["wheelset"] for one in found["used_entries"]] == ["WS-002", "WS-001"]
    assert found["left_out"] == {"same_wheelset": 4}
    geometry = client.get(found["links"]["geometry"]).json()
    assert geometry["equivalent_conicity_1"]["value"] == 0.25, "the geometry has nothing of it"


def test_a_wheelset_without_an_answer_has_none(client: httpx.Client) -> None:
    assert client.get("/v1/wheelsets/WS-003/signature").status_code == 404
    assert client.get("/v1/wheelsets/none/signature").status_code == 404


def test_entries_of_fleets_that_are_not_seen_are_not_named(service: Service) -> None:
    record = api_fleet.signature_record()
    seen = signature_answer(record, {"WS-002"})
    assert [one.wheelset for one in seen.used_entries] == ["WS-002"]
    assert "WS-001" not in seen.model_dump_json()
    with service.storage.seen_by(frozenset({"alpha"})).read() as unit:
        visible = {one.serial for one in unit.registry.wheelsets_of([one.wheelset for one in record.value.answer.used])}
    assert len(visible) == 1
