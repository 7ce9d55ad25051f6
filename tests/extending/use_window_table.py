"""The resource of the page answers with the bin table of a window."""

from __future__ import annotations

import math
import sys
from contextlib import closing
from pathlib import Path

import httpx
import stored_values as make
from running_service import running

import api
import estimation
from api.app import document_text
from api.factory import open_store
from api.settings import Settings
from api.times import to_rfc3339
from bench.put_values import put_table
from fleet_db.migrate import upgrade

Path(api.__file__).with_name("openapi.json").write_text(document_text(), encoding="utf-8")  # as ``openapi --write``
settings = Settings(data_dir=Path(sys.argv[1]), port=0, access="open", log_level="warning", _env_file=None)
upgrade(settings.url)
with closing(open_store(settings)) as storage:
    make.populate(storage)
    table = make.bin_table()
    with storage.write() as unit:
        for number in range(2):
            unit.windows.put(make.window(number), 1.0, 1)
        put_table(unit, "WS-1", make.START, table, 1, unit.windows.get("WS-1", make.START).content_digest)
    with running(settings) as url, httpx.Client(base_url=url, timeout=60.0) as client:
        path = "/v1/wheelsets/WS-1/windows/table"
        found = client.get(path, params={"at": to_rfc3339(make.START)}).json()
        assert found["parameter_key"] == table.parameter_key, found
        assert len(found["edges_mm"]) == len(found["samples"]) + 1
        assert math.isclose(sum(found["samples"]), table.weight.sum())
        assert client.get(found["links"]["self"]).json() == found
        assert client.get(path, params={"at": to_rfc3339(make.START + make.LENGTH)}).status_code == 404
        assert client.get(path, params={"at": "yesterday"}).status_code == 422
        assert client.get(path).status_code == 422
print(estimation.__file__)  # noqa: T201 - for the test: which copy ran
