"""Track sections, and what is known of their alignment and gauge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fastapi import APIRouter, Response
from pydantic import Field, JsonValue

from api.asking import AskedDep, AskedListDep, Code, Version
from api.problems import described
from api.schemas.common import Derived, Links, Page, Representation, finite, finite_list, segment
from api.times import Timestamp, to_rfc3339
from estimation.values.reasons import ReasonCode
from estimation.values.track import AlignmentRecord, Iterated, TrackAlignment, TrackReport, TrackSectionRecord
from estimation.values.units import IN_MM
from fleet_db.rows import present
from fleet_db.storage import SqlUnitOfWork


class LinePoint(Representation):
    """A point of a section's line."""

    distance_m: float = Field(description="Distance along the section.")
    latitude_deg: float = Field(description="Latitude (WGS84).")
    longitude_deg: float = Field(description="Longitude (WGS84).")


class TrackSection(
    Derived,
    of=TrackSectionRecord,
    without=("line",),
    columns="code number name rail_profile rail_inclination_1 nominal_gauge_mm length_m tonnage_mgt_per_year"
    " coordinates links",
    links={
        "self": "/v1/track-sections/{code}",
        "alignment": "/v1/track-sections/{code}/alignment",
        "alignments": "/v1/track-sections/{code}/alignments",
        "alignment_report": "/v1/track-sections/{code}/alignment-report",
    },
):
    """A section of line; `number` identifies it on the vehicle's bus."""

    coordinates: list[LinePoint] | None = Field(description="WGS84. Null: positions are not checked by GNSS.")


class Journey(Representation):
    """Windows of one vehicle on one run over the section.

    They were at `measured + offset + scale (measured - middle)`.
    """

    vehicle: str
    measured_from: Timestamp
    passes: int
    offset_m: float | None = Field(description="Correction of its positions; null where there is none.")
    scale_1: float | None = Field(description="Relative correction of its distances; null where there is none.")
    middle_m: float | None = Field(
        description="Middle of the section as the correction is counted from it; null where there is none."
    )
    residual_rms_mm: float | None
    used: bool = Field(description="Whether the alignment was estimated with it.")
    reason: str | None
    reason_code: ReasonCode | None


class Convergence(Representation):
    """How the iteration of one quantity ended."""

    of: Iterated = Field(description="The quantity that was iterated.")
    converged: bool = Field(description="Whether the iteration stopped changing.")
    rounds: int
    change_m: float | None = Field(description="By the last round, of positions and gauge.")
    change_1: float | None = Field(description="By the last round, of stiffness ratios.")


class AlignmentReport(Derived, of=TrackReport, without=("input_digest", "report", "report_id")):
    """What a run of the alignment job found of a section, and from what."""

    passes: int
    wheelsets: int = Field(description="Lives of profiles, by mileage interval.")
    mean_passes_1: float | None = Field(description="Per place that has any.")
    diversity_1: float | None = Field(description="How far the passes of a place differ: 0 means no information.")
    covered_1: float | None = Field(description="Share of the section whose alignment is known.")
    converged: bool = Field(description="Positions, stiffness ratios and, where it is estimated, gauge have converged.")
    convergence: list[Convergence] = Field(description="Of each quantity; empty where nothing was estimated.")
    rounds: int
    moved_m: float | None = Field(description="By which the last round moved a position at most.")
    residual_rms_mm: float | None
    alignment_std_mm: float | None = Field(description="Median along the section.")
    evidence: list[str] = Field(description="What was known besides the passes.")
    recording: str | None = Field(description="Check of the surveyed alignment against the fleet.")
    recording_code: ReasonCode | None = Field(description="Null where the survey was not checked.")
    refused_windows: dict[str, int] = Field(description="Windows without a pass, by the sentence of the reason.")
    refused_windows_by_code: dict[ReasonCode, int] = Field(description="Windows without a pass, by reason.")
    parameters: dict[str, JsonValue] = Field(description="Settings that shaped it; empty where none were kept.")
    journeys: list[Journey] = Field(description="The runs that it was found from.")
    links: Links


_ALIGNMENT_LINKS = {
    "self": "/v1/track-sections/{section}/alignment?version={version}",
    "section": "/v1/track-sections/{section}",
    "alignments": "/v1/track-sections/{section}/alignments",
}


class AlignmentVersion(
    Derived, of=AlignmentRecord, without=("alignment_std_m", "points", "superseded_ns"), links=_ALIGNMENT_LINKS
):
    """A version of what is known of a section, without its columns."""


class Alignment(AlignmentVersion):
    """Lateral alignment and gauge deviation along a section, column by column; null where not known."""

    position_m: list[float] = Field(description="Position along the section, of each value.")
    alignment_mm: list[float | None] = Field(description="Positive to the left.")
    alignment_std_mm: list[float | None] = Field(
        description="Standard deviation of the alignment at each position; null where not known."
    )
    gauge_deviation_mm: list[float | None] = Field(
        description="As surveyed. Null where no gauge is on file: passes do not determine its sign."
    )
    gauge_deviation_std_mm: list[float | None] = Field(
        description="Standard deviation of the gauge deviation; null where not known."
    )
    passes: list[int] = Field(description="Passes behind each value; 0 where a recording car measured it.")
    report: AlignmentReport | None = Field(description="Of the run that made it; null of a recording as registered.")


class AlignmentSummary(
    Derived,
    of=AlignmentRecord,
    without=("superseded_ns",),
    columns="section version status source cut_off_m scale_std_1 gauge_known same_since_version recorded_at links"
    " points alignment_std_mm",
    links=_ALIGNMENT_LINKS,
):
    """A version in the list of versions."""


def section(record: TrackSectionRecord) -> TrackSection:
    """Return the representation of a track section."""
    line = record.line and [LinePoint(**dict(zip(LinePoint.model_fields, point, strict=True))) for point in record.line]
    return TrackSection.made(record, coordinates=line)


def alignment(columns: TrackAlignment, record: AlignmentRecord, made_by: TrackReport | None) -> Alignment:
    """Return the representation of an alignment."""
    unknown: list[float | None] = [None] * len(columns.s)
    return Alignment.made(
        record,
        position_m=[float(s) for s in columns.s],
        alignment_mm=finite_list(columns.alignment, IN_MM),
        alignment_std_mm=finite_list(columns.alignment_std, IN_MM),
        gauge_deviation_mm=finite_list(columns.gauge_deviation, IN_MM) if columns.gauge_known else unknown,
        gauge_deviation_std_mm=finite_list(columns.gauge_deviation_std, IN_MM) if columns.gauge_known else unknown,
        passes=[int(n) for n in columns.passes],
        report=None if made_by is None else report(made_by),
    )


def report(record: TrackReport) -> AlignmentReport:
    """Return the representation of what a run found."""
    path = f"/v1/track-sections/{segment(record.section)}"
    report = record.report
    in_force = {} if record.version is None else {"alignment": _path(record.section, record.version)}
    return AlignmentReport.made(
        record,
        residual_rms_mm=_scaled(report.get("residual_rms_m"), IN_MM),
        alignment_std_mm=_scaled(report.get("alignment_std_m"), IN_MM),
        mean_passes_1=_scaled(report.get("mean_passes")),
        diversity_1=_scaled(report.get("diversity")),
        covered_1=_scaled(report.get("covered")),
        convergence=[_convergence(item) for item in _listed(report.get("convergence"))],
        journeys=[_journey(item) for item in _listed(report.get("journeys"))],
        links={"self": f"{path}/alignment-report", "section": path, **in_force},
        **{name: report.get(name, missing) for name, missing in _AS_STORED.items()},
    )


_AS_STORED: dict[str, Any] = {
    "passes": 0,
    "wheelsets": 0,
    "converged": False,
    "rounds": 0,
    "moved_m": None,
    "evidence": [],
    "recording": None,
    "recording_code": None,
    "refused_windows": {},
    "parameters": {},
    "refused_windows_by_code": {},
}


def _convergence(stored: dict[str, Any]) -> Convergence:
    of = Iterated(stored["of"])
    relative = of is Iterated.STIFFNESS_RATIOS
    changes = (None, stored["change"]) if relative else (stored["change"], None)
    same = {name: stored[name] for name in ("converged", "rounds")}
    return Convergence(of=of, **same, change_m=changes[0], change_1=changes[1])


def _journey(report: dict[str, Any]) -> Journey:
    same = ("vehicle", "passes", "offset_m", "scale_1", "middle_m", "used")
    return Journey(
        **{name: report[name] for name in same},
        measured_from=to_rfc3339(report["from_ns"]),
        residual_rms_mm=_scaled(report["residual_rms_m"], IN_MM),
        reason=report["reason"] or None,
        reason_code=report.get("reason_code"),
    )


def _listed(value: object) -> list[Any]:
    return value if isinstance(value, list) else []


def _scaled(value: object, scale: float = 1.0) -> float | None:
    return finite(value, scale) if isinstance(value, int | float) else None


def _path(section: str, version: int) -> str:
    return f"/v1/track-sections/{segment(section)}/alignment?version={version}"


router = APIRouter(prefix="/v1/track-sections", tags=["track sections"])


def _seen(unit: SqlUnitOfWork, report: TrackReport | None) -> TrackReport | None:
    """Return a report without the journeys of vehicles that the caller does not see: all fleets share a section."""
    if report is None:
        return None
    journeys = report.report.get("journeys")
    listed = [journey for journey in _listed(journeys) if isinstance(journey, dict)]
    named = {journey["vehicle"] for journey in listed}
    hidden = named - unit.registry.visible_vehicles(sorted(map(str, named)))
    seen: list[Any] = [journey for journey in listed if journey["vehicle"] not in hidden]
    return replace(report, report={**report.report, "journeys": seen}) if hidden else report


@router.get("", response_model=Page[TrackSection], responses=described(400))
def list_track_sections(asked: AskedListDep) -> Response:
    """List the track sections, by code."""
    with asked.read() as unit:
        sections = unit.tracks.sections()
    return asked.named(sections, lambda record: record.code, section)


@router.get("/{code}", response_model=TrackSection, responses=described(404))
def get_track_section(asked: AskedDep, code: Code) -> Response:
    """Return one track section."""
    return asked.one(lambda unit: section(unit.tracks.section(code)))


@router.get("/{code}/alignment", response_model=Alignment, responses=described(404))
def get_alignment(asked: AskedDep, code: Code, version: Version = None) -> Response:
    """Return what is known of the section's alignment and gauge, and how it was found."""
    with asked.read() as unit:
        unit.tracks.section(code)
        what = code if version is None else f"{code} version {version}"
        columns = present(unit.tracks.alignment(code, version), "alignment of track section", what)
        (record,) = unit.tracks.versions(code, columns.version - 1, 1)
        report = _seen(unit, unit.tracks.report(code, columns.version))
    return asked.answer(alignment(columns, record, report))


@router.get("/{code}/alignments", response_model=Page[AlignmentSummary], responses=described(400, 404))
def list_alignments(asked: AskedListDep, code: Code) -> Response:
    """List the versions of the section's alignment, oldest first, without their columns."""
    filters = {"section": code}
    after = asked.after_number(filters)
    with asked.read() as unit:
        unit.tracks.section(code)
        versions = unit.tracks.versions(code, after, asked.limit + 1)
    return asked.page(filters, versions, lambda record: record.version, AlignmentSummary.made)


@router.get("/{code}/alignment-report", response_model=AlignmentReport, responses=described(404))
def get_alignment_report(asked: AskedDep, code: Code) -> Response:
    """Return what the last run of the alignment job found of the section, also where it found nothing."""
    with asked.read() as unit:
        unit.tracks.section(code)
        last = _seen(unit, unit.tracks.report(code))
    return asked.answer(report(present(last, "alignment report yet of track section", code)))
