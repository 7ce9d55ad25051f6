"""What the demo asks of the REST API and prints, beside the simulated truth: wheelsets, track, what is to be done."""

from __future__ import annotations

import json
import urllib.parse
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from rich import box
from rich.console import Console
from rich.measure import Measurement
from rich.table import Table

from estimation.values.alerts import Urgency
from estimation.values.quantities import Status
from estimation.values.reasons import ReasonCode
from estimation.values.track import AlignmentSource
from estimation.worklist.row import rounded_km
from ingest.simulator.scenario import Scenario

AMPLITUDE_MM = 3.0  # of the conicities


@dataclass(frozen=True, slots=True)
class ServiceAddress:
    """Where the REST API of the demo is, and the key to ask it with; None where access is open."""

    url: str
    key: str | None


@dataclass(frozen=True, slots=True)
class WheelsetLine:
    """One wheelset as the worklist has it, beside the truth; ``None`` where nothing is estimated."""

    serial: str
    mileage_km: float | None
    true: float | None  # conicity at 3 mm, as the next two
    value: float | None
    low: float | None
    high: float | None
    slope_per_1000_km: str
    distance: str
    alerts: str

    @property
    def covers(self) -> bool | None:
        """Whether the 95 % interval holds the true conicity; None without an estimate."""
        if self.low is None or self.high is None or self.true is None:
            return None
        return self.low <= self.true <= self.high


def lines(service: ServiceAddress, truth: Path, fleet: str) -> list[WheelsetLine]:
    """Ask the REST API for the worklist of a fleet; the most urgent first."""
    true = true_campaigns(truth)
    rows = _wheelsets(service, fleet=fleet, sort="urgency")
    return [_line(row["serial"], row["state"], true[row["serial"]], _estimated_km(service, row)) for row in rows]


def _estimated_km(service: ServiceAddress, row: dict[str, Any]) -> float | None:
    """Return the mileage that a conicity is of: that of its data, which may be old, as those of a dead sensor are."""
    geometry = get(service, _path("wheelsets", row["serial"], "geometry"))
    return None if geometry is None else geometry["mileage_km"]


def _wheelsets(service: ServiceAddress, **query: str) -> list[dict[str, Any]]:
    asked = urllib.parse.urlencode({**query, "limit": 1000})
    return list(get(service, f"/v1/wheelsets?{asked}")["items"])


def true_campaigns(truth: Path) -> dict[str, list[dict[str, Any]]]:
    """Return the true campaigns of each wheelset of the simulator's side file."""
    wheelsets = json.loads(truth.read_text(encoding="utf-8"))["wheelsets"]
    return {item["serial"]: item["campaigns"] for item in wheelsets}


def get(service: ServiceAddress, path: str) -> Any:  # noqa: ANN401 - JSON
    """Return the JSON of one GET; None where there is no such thing yet."""
    headers = {} if service.key is None else {"Authorization": f"Bearer {service.key}"}
    answer = httpx.get(service.url + path, headers=headers, timeout=30.0, trust_env=False)
    return None if answer.status_code == HTTPStatus.NOT_FOUND else answer.raise_for_status().json()


def _path(*parts: str) -> str:
    return "/".join(["/v1", *(urllib.parse.quote(part, safe="") for part in parts)])


def _line(
    serial: str, state: dict[str, Any], campaigns: list[dict[str, Any]], estimated_km: float | None
) -> WheelsetLine:
    conicity = state["conicity_1"]
    low, high = conicity["interval_95"] or (None, None)
    return WheelsetLine(
        serial=serial,
        mileage_km=estimated_km,
        true=None if low is None or estimated_km is None else _true(campaigns, estimated_km),
        value=conicity["value"],
        low=low,
        high=high,
        slope_per_1000_km=_slope(state["slope_1_per_1000_km"]),
        distance=_distance(state["distance_to_limit_km"]),
        alerts=", ".join(f"{a['kind']} ({_standing(a)})" for a in state["alerts"]) or "none",
    )


def _standing(alert: dict[str, Any]) -> str:
    condition, severity = str(alert["condition"]), str(alert["severity"])
    return severity if condition == "active" else f"{severity}, {condition}"


def _true(campaigns: list[dict[str, Any]], mileage_km: float) -> float:
    """Return the true conicity of the profile that was there at a mileage, between the campaigns before and after."""
    nearest = min(campaigns, key=lambda c: abs(c["mileage_km"] - mileage_km))
    of_profile = [c for c in campaigns if c["reprofilings"] == nearest["reprofilings"]]
    conicity = [np.interp(AMPLITUDE_MM, c["amplitude_mm"], c["equivalent_conicity"]) for c in of_profile]
    return float(np.interp(mileage_km, [c["mileage_km"] for c in of_profile], conicity))


def _slope(slope: dict[str, Any]) -> str:
    if slope["value"] is None:
        return "unknown"
    low, high = slope["interval_95"]
    return f"{slope['value']:+.5f} [{low:+.5f}, {high:+.5f}]"


def _distance(forecast: dict[str, Any]) -> str:
    p10, p50, p90 = ("beyond" if forecast[p] is None else rounded_km(forecast[p]) for p in ("p10", "p50", "p90"))
    if forecast["p10"] is None and forecast["reason_code"] != ReasonCode.BEYOND_HORIZON:
        return "unknown"  # an empty forecast of a known trend is good news, of an unknown one it is none
    return f"{p50} [{p10}, {p90}]" if forecast["p10"] is not None else "beyond the horizon"


ESTIMATE = ("of km since new", "true", "conicity at 3 mm [95 %]", "covers")
OUTLOOK = ("slope per 1,000 km [95 %]", r"km to the limit \[p10, p90]")
ALERTS = ("open alerts",)
TITLE = "Wheel-rail wear, from the REST API; of each fleet the most urgent first"


def tables(wheelsets: list[WheelsetLine], console: Console) -> list[Table]:
    """Return one table where the console is wide enough for it, else one each of estimates, outlook and alerts."""
    parts = [
        (TITLE, ESTIMATE, [_estimate_cells(line) for line in wheelsets]),
        ("and what it leads to", OUTLOOK, [[line.slope_per_1000_km, line.distance] for line in wheelsets]),
        ("and what was raised", ALERTS, [[line.alerts] for line in wheelsets]),
    ]
    heads = [name for _, head, _ in parts for name in head]
    joined = [[cell for cells in row for cell in cells] for row in zip(*(rows for _, _, rows in parts), strict=True)]
    whole = _table(TITLE, heads, joined, wheelsets)
    if Measurement.get(console, console.options.update(max_width=1000), whole).maximum <= console.width:
        return [whole]
    return [_table(title, head, rows, wheelsets) for title, head, rows in parts]


def _table(title: str, head: Sequence[str], rows: list[list[str]], wheelsets: list[WheelsetLine]) -> Table:
    result = Table("wheelset", title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for name in head:
        result.add_column(name, justify="left" if name in ALERTS else "right")
    for line, row in zip(wheelsets, rows, strict=True):
        result.add_row(line.serial, *row)
    return result


def _estimate_cells(line: WheelsetLine) -> list[str]:
    is_known = line.value is not None
    return [
        "" if line.mileage_km is None else f"{line.mileage_km:,.0f}",
        "" if line.true is None else f"{line.true:.3f}",
        f"{line.value:.3f} [{line.low:.3f}, {line.high:.3f}]" if is_known else "unknown",
        {True: "yes", False: "[red]no[/red]", None: ""}[line.covers],
    ]


NAMED = 3  # wheelsets of the library
SecondOpinion = tuple[str, bool | None]  # a sentence, and whether what it states is true; None: no interval


def second_opinions(
    service: ServiceAddress, scenario: Scenario, true: Mapping[str, Sequence[Mapping[str, Any]]]
) -> Iterator[SecondOpinion]:
    """Ask the REST API for a fleet's wheelsets without a geometry, and for the low adhesion that it found."""
    for row in _wheelsets(service, fleet=scenario.fleet_code):
        said = _by_signature(service, row["serial"], true)
        if said is not None:
            yield said
    for alert in get(service, "/v1/alerts?kind=low_adhesion&open=true&limit=1000")["items"]:
        if alert["track_section"] == scenario.section.code:
            yield (f"{_low(service, scenario.section.code)}; true {_true_friction(scenario)}", None)


def _by_signature(
    service: ServiceAddress, serial: str, true: Mapping[str, Sequence[Mapping[str, Any]]]
) -> SecondOpinion | None:
    geometry = get(service, _path("wheelsets", serial, "geometry"))
    if geometry["equivalent_conicity_1"]["value"] is not None:
        return None
    signature = get(service, _path("wheelsets", serial, "signature"))
    reason = geometry["equivalent_conicity_1"]["reason"].rstrip(".")
    head = f"{serial}: no geometry ({reason})"
    if signature is None:
        return (f"{head}, and no signature yet", None)
    conicity = signature["equivalent_conicity_at_3_mm_1"]
    if conicity["value"] is None:
        return (f"{head}; its signature leaves it open: {conicity['reason']}", None)
    low, high = conicity["interval_95"]
    newest = true[serial][-1]
    truth = float(np.interp(AMPLITUDE_MM, newest["amplitude_mm"], newest["equivalent_conicity"]))
    named = ", ".join([*dict.fromkeys(entry["wheelset"] for entry in signature["used_entries"])][:NAMED])
    text = (
        f"{head}; its signature says {conicity['value']:.3f} [{low:.3f}, {high:.3f}], true {truth:.3f}, from"
        f" {signature['library_wheelsets']} wheelsets of known conicity, above all {named}"
    )
    return text, low <= truth <= high


def _true_friction(scenario: Scenario) -> str:
    creep = scenario.creep
    parts = [f"{stretch.friction:.2f} at {stretch.begin:g} to {stretch.end:g} m" for stretch in creep.stretches]
    return ", ".join([*parts, f"{creep.friction:.2f} elsewhere"])


def _low(service: ServiceAddress, section: str) -> str:
    friction = get(service, _path("track-sections", section, "adhesion"))
    parts = []
    for stretch in friction["low_stretches"]:
        inside = [place for place in friction["places"] if stretch["from_m"] <= place["from_m"] < stretch["to_m"]]
        values = [place["friction_1"]["value"] for place in inside if place["friction_1"]["value"] is not None]
        parts.append(f"{stretch['from_m']:g} to {stretch['to_m']:g} m, friction {min(values):.2f} to {max(values):.2f}")
    return f"track {section}: alert of low adhesion in the feed, at {'; '.join(parts)}"


def track_lines(service: ServiceAddress) -> list[str]:
    """Ask the REST API for every section; return one sentence or two of each."""
    return [_section_line(service, item) for item in get(service, "/v1/track-sections?limit=1000")["items"]]


def _section_line(service: ServiceAddress, section: dict[str, Any]) -> str:
    path = _path("track-sections", section["code"])
    versions: list[dict[str, Any]] = []
    following: str | None = f"{path}/alignments?limit=1000"
    while following is not None:
        page = get(service, following)
        versions += page["items"]
        following = page["next"]
    report = get(service, f"{path}/alignment-report")
    head = f"track {section['code']}, {section['length_m'] / 1000:g} km"
    if not versions:
        reason = f": {report['reason']}" if report and report["reason"] else ""
        return f"{head}: not surveyed, and the fleet has not estimated its alignment yet{reason}"
    newest = versions[-1]
    if newest["source"] == AlignmentSource.RECORDED and newest["status"] != Status.ESTIMATED:
        return f"{head}: the gauge alone is on file, and the fleet has not found the alignment"
    if newest["source"] == AlignmentSource.RECORDED:
        verdict = f", {report['recording']}" if report and report["recording"] else ""
        return f"{head}: alignment on file, version {newest['version']}{verdict}"
    filed = {version["status"] for version in versions if version["source"] == AlignmentSource.RECORDED}
    how = "the surveyed alignment is not used" if Status.ESTIMATED in filed else "not surveyed"
    how = "the gauge alone is on file" if filed == {Status.UNESTIMATED} else how
    return f"{head}: {how}; the fleet has found its alignment, {_alignment_words(newest, report)}"


def _alignment_words(newest: dict[str, Any], report: dict[str, Any] | None) -> str:
    words = [f"now version {newest['version']}"]
    if newest["alignment_std_mm"] is not None:
        words.append(f"std {newest['alignment_std_mm']:.2f} mm at wavelengths of up to {newest['cut_off_m']:g} m")
    if report is not None and report["covered_1"] is not None:
        words.append(f"known along {report['covered_1']:.0%}")
    used = [journey for journey in (report or {}).get("journeys", []) if journey["used"]]
    offsets = [abs(journey["offset_m"]) for journey in used if journey["offset_m"]]
    if offsets:
        words.append(f"positions of the last journeys put right by up to {max(offsets):.1f} m")
    return ", ".join(words)


NOTHING_TO_DO = (Urgency.FINE, Urgency.NOT_MOUNTED)


def to_do(service: ServiceAddress, serials: Collection[str]) -> list[str]:
    """Ask the REST API for the worklist; return a sentence for each of some wheelsets that needs somebody."""
    sentences = []
    for row in _wheelsets(service, sort="urgency"):
        if row["serial"] in serials and row["state"]["urgency"] not in NOTHING_TO_DO:
            reasons = "; ".join(reason["text"] for reason in row["state"]["reasons"])
            sentences.append(f"{row['serial']} (vehicle {row['vehicle']}, axle {row['axle']}): {reasons}")
    return sentences
