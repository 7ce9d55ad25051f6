"""The demo's table: what the REST API says of every wheelset, beside what is true."""

from __future__ import annotations

import json
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table

KM = 1000.0


@dataclass(frozen=True, slots=True)
class WheelsetLine:
    """One wheelset, estimated and true."""

    serial: str
    mileage_km: float
    amplitude_mm: float
    true: float
    value: float | None
    low: float | None
    high: float | None
    slope_per_100000_km: str
    distance: str
    alerts: str

    @property
    def covers(self) -> bool | None:
        """Whether the 95 % interval holds the true conicity; None without an estimate."""
        if self.low is None or self.high is None:
            return None
        return self.low <= self.true <= self.high


def lines(base_url: str, truth: Path) -> list[WheelsetLine]:
    """Ask the REST API for every wheelset, its geometry, trend and open alerts.

    Parameters
    ----------
    base_url
        Of the API.
    truth
        The simulator's side file.
    """
    true = {item["serial"]: item["campaigns"] for item in json.loads(truth.read_text(encoding="utf-8"))["wheelsets"]}
    serials = [item["serial"] for item in get(base_url, "/v1/wheelsets?limit=1000")["items"]]
    return [_line(base_url, serial, true[serial]) for serial in serials]


def get(base_url: str, path: str) -> Any:  # noqa: ANN401 - JSON
    """Return the JSON of one GET."""
    with urllib.request.urlopen(base_url + path, timeout=30) as answer:  # noqa: S310 - our own server
        return json.load(answer)


def _line(base_url: str, serial: str, campaigns: list[dict[str, Any]]) -> WheelsetLine:
    geometry = get(base_url, f"/v1/wheelsets/{serial}/geometry")
    trend = get(base_url, f"/v1/wheelsets/{serial}/trend")
    alerts = get(base_url, f"/v1/alerts?wheelset={serial}&open=true&limit=1000")["items"]
    conicity = geometry["equivalent_conicity_1"]
    low, high = conicity["interval_95"] or (None, None)
    amplitude = geometry["equivalent_conicity_amplitude_mm"]
    seen = min(campaigns, key=lambda c: abs(c["mileage_km"] - geometry["mileage_km"]))
    return WheelsetLine(
        serial=serial,
        mileage_km=geometry["mileage_km"],
        amplitude_mm=amplitude,
        true=float(np.interp(amplitude, seen["amplitude_mm"], seen["equivalent_conicity"])),
        value=conicity["value"],
        low=low,
        high=high,
        slope_per_100000_km=_slope(trend),
        distance=_distance(trend),
        alerts=", ".join(f"{a['kind']} ({a['severity']})" for a in alerts) or "none",
    )


def _slope(trend: dict[str, Any]) -> str:
    slope = trend["slope_1_per_1000_km"]
    if slope["value"] is None:
        return str(slope["reason"] or "unknown")
    low, high = slope["interval_95"]
    return f"{100 * slope['value']:+.3f} [{100 * low:+.3f}, {100 * high:+.3f}]"


def _distance(trend: dict[str, Any]) -> str:
    forecast = trend["distance_to_limit_km"]
    p10, p50, p90 = (None if forecast[p] is None else forecast[p] / KM for p in ("p10", "p50", "p90"))
    if p50 is None:
        return f"beyond {p10:,.0f}" if p10 is not None else "beyond the horizon"
    if p50 <= 0:
        return "reached"
    return f"{p50:,.0f} [{p10:,.0f}, {'beyond' if p90 is None else f'{p90:,.0f}'}]"


def table(found: list[WheelsetLine]) -> Table:
    """Return the table for a terminal."""
    result = Table(title="Wheel-rail wear of the fleet, as the REST API tells it", title_justify="left")
    for name in ("wheelset", "km since new", "at mm", "true conicity", "estimated [95 %]", "covers"):
        result.add_column(name, justify="right" if name != "wheelset" else "left")
    result.add_column("trend per 100,000 km [95 %]", justify="right")
    result.add_column("1,000 km to the limit [p10, p90]", justify="right")
    result.add_column("open alerts")
    for line in found:
        estimate = "unknown" if line.value is None else f"{line.value:.3f} [{line.low:.3f}, {line.high:.3f}]"
        result.add_row(
            line.serial,
            f"{line.mileage_km:,.0f}",
            f"{line.amplitude_mm:g}",
            f"{line.true:.3f}",
            estimate,
            {True: "yes", False: "[red]no[/red]", None: ""}[line.covers],
            line.slope_per_100000_km,
            line.distance,
            line.alerts,
        )
    return result
