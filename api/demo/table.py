"""The demo's table: estimates of every wheelset from the REST API beside the simulated truth."""

from __future__ import annotations

import json
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Sequence
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

KM = 1000.0


@dataclass(frozen=True, slots=True)
class ServiceAddress:
    """Where the REST API of the demo is, and the key to ask it with; None where access is open."""

    url: str
    key: str | None


@dataclass(frozen=True, slots=True)
class WheelsetLine:
    """One wheelset, estimated and true; ``None`` where nothing is estimated."""

    serial: str
    mileage_km: float | None
    amplitude_mm: float | None
    true: float | None
    value: float | None
    low: float | None
    high: float | None
    slope_per_100000_km: str
    distance: str
    alerts: str

    @property
    def covers(self) -> bool | None:
        """Whether the 95 % interval holds the true conicity; None without an estimate."""
        if self.low is None or self.high is None or self.true is None:
            return None
        return self.low <= self.true <= self.high


def lines(service: ServiceAddress, truth: Path, fleet: str) -> list[WheelsetLine]:
    """Ask the REST API for every wheelset of a fleet, its geometry, trend and open alerts; the most urgent first.

    Args:
        truth: The simulator's side file.
    """
    true = true_campaigns(truth)
    query = urllib.parse.urlencode({"fleet": fleet, "sort": "urgency", "limit": 1000})
    serials = [item["serial"] for item in get(service, f"/v1/wheelsets?{query}")["items"]]
    return [_line(service, serial, true[serial]) for serial in serials]


def true_campaigns(truth: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the true campaigns of each wheelset of the simulator's side file."""
    wheelsets = json.loads(truth.read_text(encoding="utf-8"))["wheelsets"]
    return {item["serial"]: item["campaigns"] for item in wheelsets}


def get(service: ServiceAddress, path: str) -> Any:  # noqa: ANN401 - JSON
    """Return the JSON of one GET."""
    headers = {} if service.key is None else {"Authorization": f"Bearer {service.key}"}
    asked = urllib.request.Request(service.url + path, headers=headers)  # noqa: S310 - our own server
    with urllib.request.urlopen(asked, timeout=30) as answer:  # noqa: S310 - the same
        return json.load(answer)


def get_if_any(service: ServiceAddress, path: str) -> Any:  # noqa: ANN401 - JSON
    """Return the JSON of one GET; None where there is no such thing yet."""
    try:
        return get(service, path)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code != HTTPStatus.NOT_FOUND:
            raise
        return None


def _line(service: ServiceAddress, serial: str, campaigns: list[dict[str, Any]]) -> WheelsetLine:
    at = f"/v1/wheelsets/{urllib.parse.quote(serial, safe='')}"
    geometry, trend = (_recorded(get(service, f"{at}/{name}")) for name in ("geometry", "trend"))
    query = urllib.parse.urlencode({"wheelset": serial, "open": "true", "limit": 1000})
    alerts = get(service, f"/v1/alerts?{query}")["items"]
    conicity = geometry["equivalent_conicity_1"] if geometry else {"value": None, "interval_95": None}
    low, high = conicity["interval_95"] or (None, None)
    return WheelsetLine(
        serial=serial,
        mileage_km=geometry["mileage_km"] if geometry else None,
        amplitude_mm=geometry["equivalent_conicity_amplitude_mm"] if geometry else None,
        true=_true(campaigns, geometry) if geometry and geometry["equivalent_conicity_amplitude_mm"] else None,
        value=conicity["value"],
        low=low,
        high=high,
        slope_per_100000_km=_slope(trend) if trend else "",
        distance=_distance(trend) if trend else "",
        alerts=", ".join(f"{a['kind']} ({_standing(a)})" for a in alerts) or "none",
    )


def _recorded(answer: dict[str, Any]) -> dict[str, Any] | None:
    """Return an answer; None where nothing has ever been estimated."""
    return None if answer["recorded_at"] is None else answer


def _standing(alert: dict[str, Any]) -> str:
    """Return the severity, and the condition where the data do not show the matter now."""
    condition, severity = str(alert["condition"]), str(alert["severity"])
    return severity if condition == "active" else f"{severity}, {condition}"


def _true(campaigns: list[dict[str, Any]], geometry: dict[str, Any]) -> float:
    """Return the true conicity at the amplitude of the estimate, in the campaign nearest to its mileage."""
    seen = min(campaigns, key=lambda c: abs(c["mileage_km"] - geometry["mileage_km"]))
    amplitude = geometry["equivalent_conicity_amplitude_mm"]
    return float(np.interp(amplitude, seen["amplitude_mm"], seen["equivalent_conicity"]))


def _slope(trend: dict[str, Any]) -> str:
    slope = trend["slope_1_per_1000_km"]
    if slope["value"] is None:
        return "unknown"
    low, high = slope["interval_95"]
    return f"{100 * slope['value']:+.3f} [{100 * low:+.3f}, {100 * high:+.3f}]"


def _distance(trend: dict[str, Any]) -> str:
    if trend["status"] != "estimated":
        return "unknown"  # an empty forecast of a known trend is good news, of an unknown one it is none
    forecast = trend["distance_to_limit_km"]
    p10, p50, p90 = (None if forecast[p] is None else forecast[p] / KM for p in ("p10", "p50", "p90"))
    if p50 is None:
        return f"beyond {p10:,.0f}" if p10 is not None else "beyond the horizon"
    if p50 <= 0:
        return "reached"
    return f"{p50:,.0f} [{p10:,.0f}, {'beyond' if p90 is None else f'{p90:,.0f}'}]"


ESTIMATE = ("km since new", "at mm", "true", "conicity [95 %]", "covers")
OUTLOOK = ("trend per 100,000 km [95 %]", r"1,000 km to the limit \[p10, p90]")
ALERTS = ("open alerts",)
TITLE = "Wheel-rail wear of the fleet, from the REST API; the most urgent first"


def tables(found: list[WheelsetLine], console: Console) -> list[Table]:
    """Return one table where the console is wide enough for it, else one each of estimates, outlook and alerts."""
    parts = [
        (TITLE, ESTIMATE, [_estimate_cells(line) for line in found]),
        ("and what it leads to", OUTLOOK, [_outlook_cells(line) for line in found]),
        ("and what was raised", ALERTS, [[line.alerts] for line in found]),
    ]
    heads = [name for _, head, _ in parts for name in head]
    joined = [[cell for cells in row for cell in cells] for row in zip(*(rows for _, _, rows in parts), strict=True)]
    whole = _table(TITLE, heads, joined, found)
    if Measurement.get(console, console.options.update(max_width=1000), whole).maximum <= console.width:
        return [whole]
    return [_table(title, head, rows, found) for title, head, rows in parts]


def _table(title: str, head: Sequence[str], rows: list[list[str]], found: list[WheelsetLine]) -> Table:
    result = Table("wheelset", title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in head:
        result.add_column(name, justify="left" if name in ALERTS else "right")
    for line, row in zip(found, rows, strict=True):
        result.add_row(line.serial, *row)
    return result


def _estimate_cells(line: WheelsetLine) -> list[str]:
    known = line.value is not None
    return [
        "" if line.mileage_km is None else f"{line.mileage_km:,.0f}",
        "" if line.amplitude_mm is None else f"{line.amplitude_mm:g}",
        "" if line.true is None else f"{line.true:.3f}",
        f"{line.value:.3f} [{line.low:.3f}, {line.high:.3f}]" if known else "unknown",
        {True: "yes", False: "[red]no[/red]", None: ""}[line.covers],
    ]


def _outlook_cells(line: WheelsetLine) -> list[str]:
    return [line.slope_per_100000_km, line.distance]
