"""What an epoch found, into the store: the version, the report, and where each window was."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.jobs.job import JobContext
from estimation.storage import UnitOfWork
from estimation.track.journeys import Journey, journeys
from estimation.track.passes import Pass
from estimation.track.screening.screen import PassStatus
from estimation.track.settings import AlignmentSettings
from estimation.track.update import Finding
from estimation.track.versions import requires_reestimation
from estimation.values.json_value import JsonValue
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.track import Correction, TrackAlignment, TrackReport, TrackSectionRecord
from estimation.values.windows import WindowPosition, WindowRecord, WindowState

WindowKey = tuple[str, int]  # wheelset, start


@dataclass(frozen=True, slots=True)
class EpochPasses:
    """Passes, the windows that each was made of (by its wheelset and start), and why others hold none."""

    found: Sequence[Pass]
    members: Mapping[WindowKey, Sequence[WindowKey]]
    refused: Mapping[WindowKey, Reason]

    def windows(self, item: Pass) -> Sequence[WindowKey]:
        """Return the windows of a pass, which bears the name of a life of its wheelset."""
        return self.members[item.wheelset.rsplit("#", 2)[0], item.start_ns]


@dataclass(frozen=True, slots=True)
class Epoch:
    """The windows of an epoch, what was known before, and the passes that were made of them."""

    section: TrackSectionRecord
    records: Sequence[WindowRecord]
    before: TrackAlignment | None
    digest: str
    passes: EpochPasses
    notes: tuple[str, ...] = ()  # on evidence that could not be used


def store(unit: UnitOfWork, epoch: Epoch, finding: Finding, context: JobContext) -> str:
    """Store what was found; return what became of it.

    Nothing is stored where another version has come in force since the epoch was read ("changed_meanwhile"). Windows
    of an epoch that identified nothing are left for the next, but for those that hold no pass.
    """
    now = unit.tracks.in_force(epoch.section.code)
    expected = epoch.before.version if epoch.before is not None else None
    if (now.version if now is not None else None) != expected:
        return "changed_meanwhile"
    version = expected
    if finding.made and finding.alignment is not None:
        version = _next_version(unit, epoch, finding.alignment, context)
    _report(unit, epoch, finding, version, context)
    settings = context.settings.alignment
    for position in _positions(epoch, finding, version, settings):
        _place(unit, position)
    if finding.alignment is None:
        return "unestimated"
    return "versions" if finding.made else "kept"


def _next_version(unit: UnitOfWork, epoch: Epoch, alignment: TrackAlignment, context: JobContext) -> int:
    """Store an alignment; say since which version what it is used for stays the same."""
    now = unit.tracks.in_force(epoch.section.code)
    base = unit.tracks.alignment(epoch.section.code, now.same_since) if now is not None else None
    same_since = None
    if base is not None and not requires_reestimation(base, alignment, context.settings.alignment):
        same_since = base.version
    return unit.tracks.add_alignment(alignment, same_since=same_since, recorded_ns=context.clock.now_ns())


def _report(unit: UnitOfWork, epoch: Epoch, finding: Finding, version: int | None, context: JobContext) -> None:
    told = finding.estimate.report
    extra: dict[str, JsonValue] = {
        "evidence": [*told.evidence, *epoch.notes],
        "recording": finding.recording,
        "refused_windows": _counted([reason.text for reason in epoch.passes.refused.values()]),
        "refused_windows_by_code": _counted([reason.code for reason in epoch.passes.refused.values()]),
        "parameters": context.settings.alignment_parameters(),
    }
    unit.tracks.add_report(
        TrackReport(
            section=epoch.section.code,
            version=version,
            made=finding.made,
            status=told.status,
            reason=told.reason,
            windows=len(epoch.records),
            input_digest=epoch.digest,
            code_version=context.code_version,
            report=dict(told.as_json()) | extra,
            recorded_ns=context.clock.now_ns(),
        )
    )


def _counted(reasons: Sequence[str]) -> JsonValue:
    """Return how often each reason occurs."""
    return {reason: reasons.count(reason) for reason in sorted(set(reasons))}


def _positions(
    epoch: Epoch, finding: Finding, version: int | None, settings: AlignmentSettings
) -> Sequence[WindowPosition]:
    """Return where the windows were, as far as it has been found."""
    judged = list(zip(epoch.passes.found, finding.outcomes, strict=True))
    used = [item for item, outcome in judged if outcome.status is PassStatus.USED]
    journey_of = {
        key: journey
        for journey, members in journeys(used, settings.section.positions).items()
        for item in members
        for key in epoch.passes.windows(item)
    }
    told = [(key, outcome) for item, outcome in judged for key in epoch.passes.windows(item)]
    against = {key: outcome for key, outcome in told if key not in journey_of}
    spoken = {key for key, outcome in against.items() if outcome.status is PassStatus.REFUSED}
    reasons = {**epoch.passes.refused, **{key: outcome.reason for key, outcome in against.items() if outcome.reason}}
    outliers = {(one.vehicle, one.from_ns): one.reason for one in finding.estimate.report.journeys if not one.used}
    found = []
    for record in epoch.records:
        key = (record.wheelset, record.start_ns)
        plain = WindowPosition(record.wheelset, record.start_ns, record.content_digest, version)
        if key in reasons and (key in epoch.passes.refused or finding.alignment is not None):
            # on a recording a window needs no pass, unless its pass speaks against it
            believed = finding.trusted and key not in spoken
            found.append(plain if believed else replace(plain, reason=reasons[key]))
        elif finding.alignment is not None and key in journey_of:
            found.append(_corrected(plain, journey_of[key], finding, outliers, settings))
    return found


def _corrected(
    plain: WindowPosition,
    journey: Journey,
    finding: Finding,
    outliers: Mapping[Journey, Reason | None],
    settings: AlignmentSettings,
) -> WindowPosition:
    correction = finding.estimate.corrections.get(journey)
    if finding.trusted:
        far = correction is not None and _largest(correction) > settings.trusted_offset
        return plain if correction is None or not far else _moved(plain, correction)
    if journey in outliers:
        return replace(plain, reason=_uncertain(f": {outliers[journey]}"))
    if correction is None:
        return replace(plain, reason=_uncertain())
    return _moved(plain, correction)


def _uncertain(why: str = "") -> Reason:
    return Reason(ReasonCode.POSITION_UNCERTAIN, f"its position along the section is not certain{why}")


def _moved(plain: WindowPosition, correction: Correction) -> WindowPosition:
    return replace(plain, offset_m=correction.offset, scale=correction.scale, middle_m=correction.middle)


def _largest(correction: Correction) -> float:
    """Return the largest shift between the begin and twice the middle of the section, m."""
    ends = np.array([0.0, 2.0 * correction.middle])
    return float(np.abs(correction.at(ends) - ends).max())


def _place(unit: UnitOfWork, position: WindowPosition) -> None:
    """Store where a window was; one that had been estimated elsewhere waits again."""
    before = unit.tracks.position(position.wheelset, position.start_ns)
    if not unit.tracks.put_position(position):
        return
    told = (position.offset_m, position.scale, code_of(position.reason))
    was = (before.offset_m, before.scale, code_of(before.reason)) if before is not None else (0.0, 0.0, None)
    window = unit.windows.get(position.wheelset, position.start_ns)
    if told != was and window is not None and window.state is not WindowState.PENDING:
        unit.windows.mark(position.wheelset, position.start_ns, WindowState.PENDING)
