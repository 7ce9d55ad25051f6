"""What all faces say of every wheelset, side by side: REST resources, plan, alerts, tables, and the demo's terminal."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from api.demo.findings import ServiceAddress, lines
from estimation.trend.now import SCALE
from estimation.values.alerts import SHOWN_DIGITS, Condition, Severity, Urgency, number_evidence
from estimation.worklist.row import rounded_km

OF_LIMIT = ("conicity_limit", "limit_forecast")
OF_TREND = (
    *("limit_1", "probability_over_limit_1", "since_trend_km", "mileage_km"),
    *("distance_to_limit_km", "date_of_limit"),
)
QUANTILES = {"p10": 0.1, "p50": 0.5, "p90": 0.9}


@dataclass(slots=True)
class Compared:
    """How many numbers were compared, and on which two faces differ."""

    numbers: int = 0
    seen: set[str] = field(default_factory=set)  # urgencies, and kinds of alerts that were compared
    differences: list[str] = field(default_factory=list)

    def same(self, where: str, one: object, other: object) -> None:
        """Compare what two faces say."""
        self.numbers += len(one) if isinstance(one, dict | list) else 1
        if one != other:
            self.differences.append(f"{where}: {one} and {other}")

    def holds(self, where: str, *, truth: bool) -> None:
        """Note what must hold."""
        self.same(where, one=truth, other=True)


def compared(client: httpx.Client, folder: Path) -> Compared:
    """Return what differs between the faces of a service, over all wheelsets that it lists."""
    found = Compared()
    rows = {row["serial"]: row for row in _listed(client, "/v1/wheelsets?limit=1000")}
    for row in rows.values():
        found.seen.add(row["state"]["urgency"])
        _resources(client, row, found)
        _alerts(client, row, found)
        _scale(row, found)
    _table(client, rows, found)
    _plan(client, rows, found)
    _terminal(client, rows, folder, found)
    return found


def _listed(client: httpx.Client, path: str) -> Sequence[dict[str, Any]]:
    return client.get(path).raise_for_status().json()["items"]  # type: ignore[no-any-return]  # JSON


def _resources(client: httpx.Client, row: dict[str, Any], found: Compared) -> None:
    serial, state = row["serial"], row["state"]
    own = f"/v1/wheelsets/{serial}"
    found.same(f"{serial} state", client.get(f"{own}/state").json(), row)
    trend, geometry = client.get(f"{own}/trend").json(), client.get(f"{own}/geometry").json()
    for name in OF_TREND:
        found.same(f"{serial} trend {name}", trend[name], state[name])
    found.same(f"{serial} trend current_1", trend["current_1"], state["conicity_1"])
    if state["slope_1_per_1000_km"]["value"] is not None:
        found.same(f"{serial} slope", trend["slope_1_per_1000_km"], state["slope_1_per_1000_km"])
    if state["conicity_1"]["value"] is not None:
        found.same(f"{serial} geometry", geometry["equivalent_conicity_at_3_mm_1"], state["conicity_1"])


def _alerts(client: httpx.Client, row: dict[str, Any], found: Compared) -> None:
    """Compare the evidence of open alerts; one that is not assessable keeps the numbers that raised it, and says so."""
    serial, state = row["serial"], row["state"]
    alerts = _listed(client, f"/v1/alerts?wheelset={serial}&open=true&limit=1000")
    for alert in alerts:
        kind, evidence = alert["kind"], alert["evidence"]
        if alert["condition"] != Condition.ACTIVE or kind not in {*OF_LIMIT, "measure"}:
            continue
        found.seen.add(kind)
        where = f"{serial} {kind}"
        shown = {"conicity_limit": "current_1", "measure": "conicity_1"}.get(kind)
        if shown is not None:
            found.same(f"{where} conicity", evidence[shown], _rounded(state["conicity_1"]))
        found.same(f"{where} limit", evidence["limit_1"], number_evidence(state["limit_1"]))
        over = number_evidence(state["probability_over_limit_1"], 3)
        if kind == "conicity_limit":
            found.same(f"{where} probability", alert["probability_1"], over)
        if kind == "limit_forecast":
            found.same(f"{where} probability", evidence["probability_over_limit_1"], over)
            found.same(f"{where} slope", evidence["slope_1_per_1000_km"], _rounded(state["slope_1_per_1000_km"]))
            found.same(f"{where} distance", evidence["distance_to_limit_km"], _rounded(state["distance_to_limit_km"]))
            dates = [
                {name: one[name] and one[name][:10] for name in QUANTILES}
                for one in (evidence["date_of_limit"], state["date_of_limit"])
            ]
            found.same(f"{where} date", *dates)
        if kind in OF_LIMIT:
            critical = alert["severity"] == Severity.CRITICAL
            found.same(f"{where} severity", critical, state["urgency"] == Urgency.OVER_LIMIT)
            found.holds(f"{where} is no mere information", truth=alert["severity"] != Severity.INFO)


def _rounded(value: Any) -> Any:  # noqa: ANN401 - JSON
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return number_evidence(value, SHOWN_DIGITS) if isinstance(value, float) else value


def _scale(row: dict[str, Any], found: Compared) -> None:
    """Hold the words against the numbers, and the numbers against each other."""
    serial, state = row["serial"], row["state"]
    over, distance, urgency = state["probability_over_limit_1"], state["distance_to_limit_km"], state["urgency"]
    assessed = not any(alert["condition"] == Condition.UNKNOWN for alert in state["alerts"])
    if row["vehicle"] is not None and over is not None and assessed:
        is_over = over >= SCALE.over_probability
        found.same(f"{serial} over the limit at {over}", urgency == Urgency.OVER_LIMIT, is_over)
        if SCALE.probably_over_probability <= over < SCALE.over_probability:
            found.same(f"{serial} probably over", urgency, Urgency.PROBABLY_OVER)
    for name, probability in QUANTILES.items():
        if distance[name] == 0.0:
            found.holds(f"{serial} {name} is 0 at {over}", truth=over is not None and over >= probability)
    conicity, limit = state["conicity_1"], state["limit_1"]
    if urgency == Urgency.UNKNOWN and conicity["value"] is not None and limit is not None and not state["alerts"]:
        near = conicity["interval_95"][1] >= SCALE.far_below_share * limit
        found.holds(f"{serial} is unknown near its limit only", truth=near)


def _table(client: httpx.Client, rows: dict[str, dict[str, Any]], found: Compared) -> None:
    text = client.get("/v1/wheelsets?limit=1000", headers={"Accept": "text/csv"}).raise_for_status().text
    for line in csv.DictReader(io.StringIO(text, newline="")):
        state = rows[line["serial"]]["state"]
        for column, value in _columns(state):
            found.same(f"{line['serial']} table {column}", line[f"state_{column}"], value)


def _columns(state: dict[str, Any]) -> Iterator[tuple[str, str]]:
    for name in ("urgency", "limit_1", "probability_over_limit_1", "since_trend_km", "mileage_km"):
        yield name, _cell(state[name])
    for name in ("conicity_1", "slope_1_per_1000_km"):
        yield f"{name}_value", _cell(state[name]["value"])
    for name in ("distance_to_limit_km", "date_of_limit"):
        yield from ((f"{name}_{quantile}", _cell(state[name][quantile])) for quantile in QUANTILES)


def _cell(value: object) -> str:
    return "" if value is None else str(value)


def _plan(client: httpx.Client, rows: dict[str, dict[str, Any]], found: Compared) -> None:
    plan = client.get("/v1/plans/reprofiling?horizon_days=3650&together_days=0").raise_for_status().json()
    for line in plan["items"]:
        state = rows[line["wheelset"]]["state"]
        for name in ("urgency", "distance_to_limit_km", "date_of_limit"):
            found.same(f"{line['wheelset']} plan {name}", line[name], state[name])
        if line["cause"] == "due":
            found.same(
                f"{line['wheelset']} plan reason", line["reason"], "; ".join(one["text"] for one in state["reasons"])
            )


def _terminal(client: httpx.Client, rows: dict[str, dict[str, Any]], folder: Path, found: Compared) -> None:
    none = {"mileage_km": 0.0, "reprofilings": 0, "amplitude_mm": [0.0, 9.0], "equivalent_conicity": [0.0, 0.0]}
    truth = folder / "truth.json"
    truth.write_text(json.dumps({"wheelsets": [{"serial": serial, "campaigns": [none]} for serial in rows]}))
    service = ServiceAddress(str(client.base_url).rstrip("/"), None)
    for fleet in {row["fleet"] for row in rows.values()}:
        for line in lines(service, truth, fleet):
            state = rows[line.serial]["state"]
            found.same(f"{line.serial} terminal conicity", line.value, state["conicity_1"]["value"])
            found.same(
                f"{line.serial} terminal interval",
                [line.low, line.high],
                state["conicity_1"]["interval_95"] or [None, None],
            )
            geometry = client.get(f"/v1/wheelsets/{line.serial}/geometry").raise_for_status().json()
            found.same(f"{line.serial} terminal mileage", line.mileage_km, geometry["mileage_km"])
            p50 = state["distance_to_limit_km"]["p50"]
            if p50 is not None:
                found.same(f"{line.serial} terminal distance", line.distance.split(" ")[0], rounded_km(p50))
