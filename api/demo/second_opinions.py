"""What the demo prints beside the geometries: wheelsets judged by their signature, and sections of low adhesion."""

from __future__ import annotations

import urllib.parse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from api.demo.table import ServiceAddress, get, get_if_any
from ingest.simulator.scenario import Scenario

AMPLITUDE_MM = 3.0  # of the conicity by signatures
NAMED = 3  # wheelsets of the library


@dataclass(frozen=True, slots=True)
class SecondOpinion:
    """A sentence, and whether what it states is true; None where it states no interval."""

    text: str
    covers: bool | None


def second_opinions(
    service: ServiceAddress, scenario: Scenario, true: Mapping[str, Sequence[Mapping[str, Any]]]
) -> Iterator[SecondOpinion]:
    """Ask the REST API for a fleet's wheelsets without a geometry, and for the low adhesion that it found.

    Args:
        true: Campaigns of each wheelset, of the simulator's side file.
    """
    query = urllib.parse.urlencode({"fleet": scenario.fleet_code, "limit": 1000})
    for row in get(service, f"/v1/wheelsets?{query}")["items"]:
        found = _by_signature(service, row["serial"], true)
        if found is not None:
            yield found
    for alert in get(service, "/v1/alerts?kind=low_adhesion&open=true&limit=1000")["items"]:
        if alert["track_section"] == scenario.section.code:
            yield SecondOpinion(f"{_low(service, scenario.section.code)}; true {_true_friction(scenario)}", None)


def _by_signature(
    service: ServiceAddress, serial: str, true: Mapping[str, Sequence[Mapping[str, Any]]]
) -> SecondOpinion | None:
    """Return what the signature of a wheelset says, where its geometry says nothing."""
    at = f"/v1/wheelsets/{urllib.parse.quote(serial, safe='')}"
    geometry = get(service, f"{at}/geometry")
    if geometry["equivalent_conicity_1"]["value"] is not None:
        return None
    signature = get_if_any(service, f"{at}/signature")
    reason = geometry["equivalent_conicity_1"]["reason"].rstrip(".")
    head = f"{serial}: no geometry ({reason})"
    if signature is None:
        return SecondOpinion(f"{head}, and no signature yet", None)
    conicity = signature["equivalent_conicity_at_3_mm_1"]
    if conicity["value"] is None:
        return SecondOpinion(f"{head}; its signature leaves it open: {conicity['reason']}", None)
    low, high = conicity["interval_95"]
    newest = true[serial][-1]
    truth = float(np.interp(AMPLITUDE_MM, newest["amplitude_mm"], newest["equivalent_conicity"]))
    named = ", ".join([*dict.fromkeys(entry["wheelset"] for entry in signature["used_entries"])][:NAMED])
    return SecondOpinion(
        f"{head}; its signature says {conicity['value']:.3f} [{low:.3f}, {high:.3f}], true {truth:.3f}, from"
        f" {signature['library_wheelsets']} wheelsets of known conicity, above all {named}",
        low <= truth <= high,
    )


def _true_friction(scenario: Scenario) -> str:
    stretches = [f"{one.friction:.2f} at {one.begin:g} to {one.end:g} m" for one in scenario.running.stretches]
    return ", ".join([*stretches, f"{scenario.running.creep.friction:.2f} elsewhere"])


def _low(service: ServiceAddress, section: str) -> str:
    found = get(service, f"/v1/track-sections/{urllib.parse.quote(section, safe='')}/adhesion")
    parts = []
    for stretch in found["low_stretches"]:
        inside = [one for one in found["places"] if stretch["from_m"] <= one["from_m"] < stretch["to_m"]]
        known = [one["friction_1"]["value"] for one in inside if one["friction_1"]["value"] is not None]
        parts.append(f"{stretch['from_m']:g} to {stretch['to_m']:g} m, friction {min(known):.2f} to {max(known):.2f}")
    return f"track {section}: alert of low adhesion in the feed, at {'; '.join(parts)}"
