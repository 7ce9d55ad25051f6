"""Step: sections on which nothing has happened since a job last found nothing to do there are not looked at again."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping

from estimation.jobs.job import JobContext
from estimation.storage import UnitOfWork
from estimation.values.runs import SectionLook

NO_SECTION = ""
"""Stands for the windows that are on no section."""


def section_news(unit: UnitOfWork, context: JobContext, stage: str) -> dict[str, SectionLook]:
    """Return the sections to look at, each with what the look will have been made from.

    A look at a section rests on its windows, their positions and the epochs that hold them, which are counted as they
    change (``fleet_db.changes``), and on what is compared here: its record, its alignments and layouts, classes and
    settings. Sections that are not on file any more count by their windows alone.

    Args:
        unit: All of it as one transaction sees it, before the look.
    """
    seen, touched = unit.section_looks.of(stage), unit.section_looks.touched()
    common = _common(unit, context)
    standing = unit.tracks.standings()
    on_file = {section.code: f"{section!r} {standing.get(section.code)!r}" for section in unit.tracks.sections()}
    now = {
        code: SectionLook(_digest(f"{on_file.get(code, '')} {common}"), touched.get(code, 0))
        for code in {NO_SECTION, *touched, *on_file}
    }
    return {code: look for code, look in now.items() if seen.get(code) != look}


def note_sections(context: JobContext, stage: str, looks: Mapping[str, SectionLook]) -> None:
    """Note looks that found nothing to do; without any nothing is written."""
    if looks:
        with context.storage.write() as unit:
            unit.section_looks.note(stage, looks)


def _common(unit: UnitOfWork, context: JobContext) -> str:
    """Return a digest of what looks at all sections rest on."""
    classes = [(code, unit.registry.vehicle_class(code)) for code in unit.registry.classes_in_use()]
    digests = [(code, None if found is None else found.digest) for code, found in classes]
    settings = context.settings
    text = f"{digests!r} {settings.alignment_parameters()!r} {settings.estimation.as_json()!r} {context.code_version}"
    return _digest(text)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
