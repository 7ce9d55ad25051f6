"""What a window waits for, and why a section has no alignment: sentences from what is stored, nothing is computed."""

from __future__ import annotations

from dataclasses import dataclass, replace

from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, utc_text
from estimation.values.runs import JobOutcome, JobRun, Quarantined
from estimation.values.track import AlignmentRecord, AlignmentSource

ESTIMATION, ALIGNMENT, GEOMETRY = "estimate_windows", "refresh_alignment", "refresh_geometry"
"""Jobs that make bin tables of windows, alignments of sections, and geometries of wheelsets."""


@dataclass(frozen=True, slots=True)
class SectionFacts:
    """What is stored of a section and decides what its windows wait for."""

    code: str  # of the section
    in_force: AlignmentRecord | None = None  # its alignment; None where there is none
    looked_at: bool = False  # whether its passes have been looked at
    found: Reason | None = None  # why the last look found no alignment; None where it did
    survey: Reason | None = None  # why the survey on file is not used; None where it is, or there is none
    failed: Quarantined | None = None  # last failure of :data:`ALIGNMENT` at it; None where it succeeded

    @property
    def aligned(self) -> bool:
        """Whether windows can be estimated on it."""
        return self.in_force is not None and self.in_force.status is Status.ESTIMATED

    @property
    def placed_by_fleet(self) -> bool:
        """Whether windows are estimated only where their place on it is found: on a survey they are not."""
        return self.in_force is not None and self.in_force.source is AlignmentSource.FLEET


def waits_for(
    section: SectionFacts | None, no_class: Reason | None, last_run: JobRun | None, *, placed: bool
) -> Reason:
    """Return what a window waits for; None is a section not known, a class on file, a job that has never run."""
    if no_class is not None:
        return no_class
    if section is not None and not section.aligned:
        return no_alignment(section)
    if section is not None and section.placed_by_fleet and not placed:
        text = f"its place on section {section.code} is not found yet: {_looked(section)}"
        return Reason(ReasonCode.WAITS_FOR_POSITION, text)
    return Reason(ReasonCode.WAITS_FOR_ESTIMATION, f"it waits for {_next_run(ESTIMATION, last_run)}")


def no_alignment(section: SectionFacts) -> Reason:
    """Return that a section has no alignment, and why."""
    survey = "" if section.survey is None else f"; the survey is {section.survey.text}"
    text = f"the alignment of section {section.code} is not known yet: {_looked(section)}{survey}"
    return Reason(ReasonCode.ALIGNMENT_UNKNOWN, text)


def tried_again(reason: Reason, failed: Quarantined | None) -> Reason:
    """Return a reason with when it is tried again, where a failure is kept."""
    if failed is None:
        return reason
    return replace(reason, text=f"{reason.text}; {_again(failed)}")


def no_geometry_yet(last_run: JobRun | None, failed: Quarantined | None) -> Reason:
    """Return why estimated windows have given no geometry."""
    if failed is not None:
        return Reason(failed.code, f"{GEOMETRY} failed at it: {failed.error}; {_again(failed)}")
    return Reason(ReasonCode.NO_GEOMETRY, f"the geometry waits for {_next_run(GEOMETRY, last_run)}")


def _looked(section: SectionFacts) -> str:
    if section.failed is not None:
        return f"{ALIGNMENT} failed at it: {section.failed.error}; {_again(section.failed)}"
    if section.found is not None:
        return section.found.text
    return f"{ALIGNMENT} looks at it again with the next passes" if section.looked_at else f"{ALIGNMENT} has yet to run"


def _again(failed: Quarantined) -> str:
    return f"tried again from {utc_text(failed.due_ns)} on ({failed.attempts} failures in a row)"


def _next_run(job: str, last: JobRun | None) -> str:
    """Return the next run of a job in words, with the last one."""
    if last is None:
        return f"{job}, which has never run"
    began = utc_text(last.started_ns)
    if last.outcome is JobOutcome.RUNNING:
        return f"{job}, which has been running since {began}"
    if last.outcome is JobOutcome.SUCCEEDED:
        return f"the next run of {job}"
    return f"the next run of {job}; the last, of {began}, {last.outcome.value}: {last.error}"
