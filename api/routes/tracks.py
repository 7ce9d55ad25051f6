"""Track sections."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Query, Response

from api.asking import AskedDep, AskedListDep
from api.parameters import Code
from api.problems import described
from api.schemas import adhesion, rails, tracks
from api.schemas.common import Page
from api.times import Moment
from estimation.errors import NotFoundError
from estimation.values.fields import JsonValue
from estimation.values.rails import SECTION_RAILS
from estimation.values.track import TrackReport
from fleet_db.storage import SqlUnitOfWork

router = APIRouter(prefix="/v1/track-sections", tags=["track sections"])
Version = Annotated[int | None, Query(ge=1, le=2**31 - 1, description="Left out, the latest.")]


def _seen(unit: SqlUnitOfWork, report: TrackReport | None) -> TrackReport | None:
    """Return a report without the journeys of vehicles that the caller does not see: all fleets share a section."""
    if report is None:
        return None
    journeys = report.report.get("journeys")
    named = {one["vehicle"] for one in journeys if isinstance(one, dict)} if isinstance(journeys, list) else set()
    hidden = named - unit.registry.visible_vehicles(sorted(map(str, named)))
    if not hidden or not isinstance(journeys, list):
        return report
    kept: list[JsonValue] = [one for one in journeys if isinstance(one, dict) and one["vehicle"] not in hidden]
    return replace(report, report={**report.report, "journeys": kept})


@router.get("", response_model=Page[tracks.TrackSection], responses=described(400))
def list_track_sections(asked: AskedListDep) -> Response:
    """List the track sections, by code."""
    with asked.read() as unit:
        found = unit.tracks.sections()
    return asked.named(found, lambda record: record.code, tracks.section)


@router.get("/{code}", response_model=tracks.TrackSection, responses=described(404))
def get_track_section(asked: AskedDep, code: Code) -> Response:
    """Return one track section."""
    with asked.read() as unit:
        found = unit.tracks.section(code)
    return asked.answer(tracks.section(found))


@router.get("/{code}/alignment", response_model=tracks.Alignment, responses=described(404))
def get_alignment(asked: AskedDep, code: Code, version: Version = None) -> Response:
    """Return what is known of the section's alignment and gauge, and how it was found."""
    with asked.read() as unit:
        unit.tracks.section(code)
        found = unit.tracks.alignment(code, version)
        if found is None:
            what = code if version is None else f"{code} version {version}"
            raise NotFoundError("alignment of track section", what)
        (record,) = unit.tracks.versions(code, found.version - 1, 1)
        report = _seen(unit, unit.tracks.report(code, found.version))
    return asked.answer(tracks.alignment(found, record, report))


@router.get("/{code}/alignments", response_model=Page[tracks.AlignmentSummary], responses=described(400, 404))
def list_alignments(asked: AskedListDep, code: Code) -> Response:
    """List the versions of the section's alignment, oldest first, without their columns."""
    filters = {"section": code}
    after = asked.after_number(filters)
    with asked.read() as unit:
        unit.tracks.section(code)
        found = unit.tracks.versions(code, after, asked.limit + 1)
    return asked.page(filters, found, lambda record: record.version, tracks.alignment_summary)


@router.get("/{code}/alignment-report", response_model=tracks.AlignmentReport, responses=described(404))
def get_alignment_report(asked: AskedDep, code: Code) -> Response:
    """Return what the last run of the alignment job found of the section, also where it found nothing."""
    with asked.read() as unit:
        unit.tracks.section(code)
        found = _seen(unit, unit.tracks.report(code))
    if found is None:
        raise NotFoundError("alignment report yet of track section", code)
    return asked.answer(tracks.report(found))


@router.get("/{code}/adhesion", response_model=adhesion.SectionAdhesion, responses=described(404))
def get_adhesion(
    asked: AskedDep,
    code: Code,
    at: Annotated[Moment | None, Query(description="Of the hours that hold this time; left out, of the last.")] = None,
) -> Response:
    """Return the friction along the section, pooled over the fleets, and where it is low."""
    with asked.read() as unit:
        unit.tracks.section(code)
        found = unit.adhesion.section(code, at)
    if found is None:
        raise NotFoundError("adhesion yet of track section", code)
    return asked.answer(adhesion.section_adhesion(found))


@router.get("/{code}/rails", response_model=rails.SectionRails, responses=described(404))
def get_section_rails(asked: AskedDep, code: Code) -> Response:
    """Return what belongs to the rails of the section, in the conicities of the wheelsets that ran on it."""
    with asked.read() as unit:
        unit.tracks.section(code)
        found = unit.results.latest(SECTION_RAILS, code)
    if found is None:
        raise NotFoundError("rails yet of track section", code)
    return asked.answer(rails.section_rails(found))
