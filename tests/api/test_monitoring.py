"""The rules and the board of docs/operations ask for measures that the services really expose."""

from __future__ import annotations

import json
import re
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from access_examples import paused_webhook
from prometheus_client import generate_latest
from prometheus_client.parser import text_string_to_metric_families
from running_service import Service

from api.factory import open_store
from api.metrics import webhook_measures
from api.settings import Settings
from api.terminal.health_server import registry_of
from api.terminal.live import live_measures
from estimation.values.registry import FleetRecord
from estimation.values.windows import WindowState
from fleet_db.migrate import upgrade
from fleet_db.records import ChunkRecord, ChunkState, WebhookState
from ingest.live.status import LiveStatus

ROOT = Path(__file__).parents[2]
OPERATIONS = ROOT / "docs" / "operations"
SELECTED = re.compile(r"\b(?P<name>treadwatch_\w+)(?:\{(?P<labels>[^}]*)\})?")
OF_PROMETHEUS = {"instance", "job", "le"}


def rules() -> list[dict[str, Any]]:
    found = yaml.safe_load((OPERATIONS / "rules.yml").read_text(encoding="utf-8"))
    return [rule for group in found["groups"] for rule in group["rules"]]


def panels() -> list[dict[str, Any]]:
    board = json.loads((OPERATIONS / "grafana" / "board.json").read_text(encoding="utf-8"))
    return [panel for panel in board["panels"] if panel["type"] != "row"]


def expressions() -> list[str]:
    return [rule["expr"] for rule in rules()] + [target["expr"] for panel in panels() for target in panel["targets"]]


def exposed(text: str) -> dict[str, set[str]]:
    """Return the labels of every sample by its name."""
    found: dict[str, set[str]] = {}
    for family in text_string_to_metric_families(text):
        for sample in family.samples:
            found.setdefault(sample.name, set()).update(sample.labels)
    return found


@pytest.fixture
def measures(client: httpx.Client, tmp_path: Path) -> dict[str, set[str]]:
    """Return what service and receiver expose, each under its name, with the labels."""
    client.get("/healthz")
    live = generate_latest(registry_of(partial(live_measures, {"L-1": LiveStatus()}))).decode()
    return exposed(client.get("/metrics").text) | exposed(live) | of_an_active_webhook(tmp_path)


def of_an_active_webhook(folder: Path) -> dict[str, set[str]]:
    """Return what is exposed of a webhook that nobody delivers to: it has no place in a service that would."""
    settings = Settings(data_dir=folder, _env_file=None)
    upgrade(settings.url)
    with closing(open_store(settings)) as storage:
        with storage.write() as unit:
            unit.registry.add_fleet(FleetRecord("F", "Fleet"))
        paused_webhook(storage, "F", WebhookState.ACTIVE)
        families = webhook_measures(storage)
    return {sample.name: set(sample.labels) for family in families for sample in family.samples}


def test_every_expression_asks_for_what_there_is(measures: dict[str, set[str]]) -> None:
    asked = [(match["name"], match["labels"] or "") for text in expressions() for match in SELECTED.finditer(text)]
    assert len(asked) > 30
    assert {name for name, _ in asked} - set(measures) == set()
    for name, labels in asked:
        assert set(re.findall(r"(\w+)\s*(?:=~|!=|!~|=)", labels)) <= measures[name], name
    for text in expressions():
        grouped = {label for listed in re.findall(r"by \(([^)]*)\)", text) for label in re.split(r",\s*", listed)}
        names = {match["name"] for match in SELECTED.finditer(text)}
        assert grouped <= set().union(*(measures[name] for name in names)) | OF_PROMETHEUS, text


def test_what_a_rule_and_a_panel_say_uses_labels_that_are_left(measures: dict[str, set[str]]) -> None:
    for rule in rules():
        names = [match["name"] for match in SELECTED.finditer(rule["expr"])]
        there = set().union(*(measures[name] for name in names)) if names else set()
        for label in re.findall(r"\$labels\.(\w+)", rule["annotations"]["summary"]):
            assert label in there | OF_PROMETHEUS, rule["alert"]
        assert rule["labels"]["severity"] in {"warning", "critical"}
    assert len({rule["alert"] for rule in rules()}) == len(rules())


def test_measures_have_few_series(client: httpx.Client) -> None:
    for family in text_string_to_metric_families(client.get("/metrics").text):
        for sample in family.samples:
            assert not {"wheelset", "vehicle", "digest"} & set(sample.labels), sample.name


def test_the_oldest_that_waits_and_who_is_silent_are_measured(service: Service) -> None:
    record = ChunkRecord("e5" * 32, "V-0", ".blf", 1, ChunkState.STORED, None, None, None, 0, {}, 7 * 10**9, 7 * 10**9)
    with service.storage.write() as unit:
        unit.chunks.put(record)
    text = service.client.get("/metrics").text
    families = text_string_to_metric_families(text)
    samples = {(one.name, *one.labels.values()): one.value for family in families for one in family.samples}
    assert samples["treadwatch_oldest_waiting_timestamp_seconds", "recording"] == 7.0
    with service.storage.read() as unit:
        counts = unit.windows.counts()
    waits = samples["treadwatch_oldest_waiting_timestamp_seconds", "window"]
    assert (waits > 0.0) == (counts.get(WindowState.PENDING.value, 0) > 0)
    assert samples["treadwatch_recordings", "stored"] >= 1.0
    with service.storage.write() as unit:
        unit.chunks.update(replace(record, state=ChunkState.DELETED))


def test_prometheus_and_grafana_of_compose_get_these_files() -> None:
    text = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    mounted = set(re.findall(r"\./(docs/operations/[\w./-]+):", text))
    assert mounted == {
        str(path.relative_to(ROOT))
        for path in OPERATIONS.rglob("*")
        if path.is_file() and path.name != "rules-test.yml"
    }
    (datasource,) = yaml.safe_load((OPERATIONS / "grafana" / "datasource.yml").read_text())["datasources"]
    assert {panel["datasource"]["uid"] for panel in panels()} == {datasource["uid"]}
    jobs = {one["job_name"] for one in yaml.safe_load((OPERATIONS / "prometheus.yml").read_text())["scrape_configs"]}
    assert jobs == {"api", "receiver"}
