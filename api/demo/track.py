"""What the demo prints about the track: whether it was surveyed, what the fleet has estimated, and from what."""

from __future__ import annotations

import urllib.parse
from typing import Any

from api.demo.table import ServiceAddress, get, get_if_any
from estimation.values.quantities import Status
from estimation.values.track import AlignmentSource


def track_lines(service: ServiceAddress) -> list[str]:
    """Ask the REST API for every section; return one sentence or two of each."""
    return [_said(service, item) for item in get(service, "/v1/track-sections?limit=1000")["items"]]


def _said(service: ServiceAddress, section: dict[str, Any]) -> str:
    at = f"/v1/track-sections/{urllib.parse.quote(section['code'], safe='')}"
    versions = _versions(service, f"{at}/alignments?limit=1000")
    report = get_if_any(service, f"{at}/alignment-report")
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
    filed = {one["status"] for one in versions if one["source"] == AlignmentSource.RECORDED}
    how = "the surveyed alignment is not used" if Status.ESTIMATED in filed else "not surveyed"
    how = "the gauge alone is on file" if filed == {Status.UNESTIMATED} else how
    return f"{head}: {how}; the fleet has found its alignment, {_found(newest, report)}"


def _versions(service: ServiceAddress, path: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = []
    following: str | None = path
    while following is not None:
        page = get(service, following)
        found += page["items"]
        following = page["next"]
    return found


def _found(newest: dict[str, Any], report: dict[str, Any] | None) -> str:
    words = [f"now version {newest['version']}"]
    if newest["alignment_std_mm"] is not None:
        words.append(f"std {newest['alignment_std_mm']:.2f} mm at wavelengths of up to {newest['cut_off_m']:g} m")
    if report is not None and report["covered_1"] is not None:
        words.append(f"known along {report['covered_1']:.0%}")
    offsets = [abs(one["offset_m"]) for one in (report or {}).get("journeys", []) if one["used"] and one["offset_m"]]
    if offsets:
        words.append(f"positions of the last journeys put right by up to {max(offsets):.1f} m")
    return ", ".join(words)
