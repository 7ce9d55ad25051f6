"""Job: new windows of a section tell its alignment better, and it tells where they were.

Each section is done in epochs: the windows of which nobody has looked where they were, a bounded number, become passes;
these and the alignment in force become the next version. So a run costs its new windows and not the history. Windows of
an epoch that identifies nothing stay, and are looked at again together with those that come.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.errors import DamagedError, StoppedError, TreadwatchError
from estimation.jobs.job import Job, JobContext
from estimation.jobs.store_alignment import Epoch, store
from estimation.ports import TrackSectionRecord, UnitOfWork, WindowRecord
from estimation.settings import EstimationSettings
from estimation.track.epochs import AlignmentSettings, bounded, epoch_digest, life, reduced
from estimation.track.examination import examine
from estimation.track.passes import Pass
from estimation.track.recordings import find
from estimation.types import TrackAlignment
from estimation.window_table import gate

_COUNTS = ("sections", "windows", "passes", "versions", "kept", "unestimated", "unchanged", "changed_meanwhile")


def run(context: JobContext) -> Mapping[str, int]:
    """Look at the new windows of every section; each epoch is committed together.

    Raises
    ------
    TreadwatchError
        A section failed; raised after all other sections are done.
    """
    counts: Counter[str] = Counter(dict.fromkeys(_COUNTS, 0))
    failed: list[Exception] = []
    with context.storage.read() as unit:
        sections = unit.tracks.sections()
    for section in sections:
        counts["sections"] += 1
        try:
            while _next_epoch(context, section, counts):
                pass
        except StoppedError:
            raise
        except (TreadwatchError, np.linalg.LinAlgError) as error:
            failed.append(error)  # the other sections go on
    if failed:
        raise failed[0]
    return dict(counts)


JOB = Job("refresh_alignment", "Find the alignment of sections and the positions of windows", every_s=600.0, run=run)


@dataclass(frozen=True, slots=True)
class _Waiting:
    """New windows of a section and what was known of it when they were read."""

    records: Sequence[WindowRecord]
    lives: Sequence[str]
    in_force: TrackAlignment | None
    looked_at: str | None  # digest of the last report
    judged: bool  # the recording in force has been held against the fleet


def _next_epoch(context: JobContext, section: TrackSectionRecord, counts: Counter[str]) -> bool:
    """Do one epoch of a section; return whether there may be another."""
    with context.storage.read() as unit:
        waiting = _waiting(unit, section, context)
    version = waiting.in_force.version if waiting.in_force is not None else None
    digest = epoch_digest(waiting.records, version, context.code_version)
    if not waiting.records or digest == waiting.looked_at:
        counts["unchanged"] += 1
        return False
    found, refused = _passes(context, waiting)
    left = [record for record in waiting.records if (record.wheelset, record.start_ns) not in refused]
    digest = epoch_digest(left, version, context.code_version)  # of what the next run would find again
    epoch = Epoch(section, waiting.records, waiting.in_force, digest, found, refused)
    settings = context.setting(AlignmentSettings)
    finding = find(section, found, waiting.in_force, settings, judge=not waiting.judged)
    with context.storage.write() as unit:
        outcome = store(unit, epoch, finding, context)
    counts[outcome] += 1
    counts["windows"] += len(waiting.records)
    counts["passes"] += len(found)
    return outcome in {"versions", "kept"}


def _waiting(unit: UnitOfWork, section: TrackSectionRecord, context: JobContext) -> _Waiting:
    settings, interval_km = context.setting(AlignmentSettings), context.setting(EstimationSettings).interval_km
    records = unit.windows.unplaced(section.code, settings.most_windows)
    wheelsets = {serial: unit.registry.wheelset(serial) for serial in {record.wheelset for record in records}}
    lives = [life(wheelsets[record.wheelset], record, interval_km) for record in records]
    chosen = bounded(records, lives, settings.most_wheelsets)
    in_force = unit.tracks.alignment(section.code)
    report = unit.tracks.report(section.code)
    told = report is not None and in_force is not None and report.version == in_force.version
    judged = told and report is not None and report.report.get("recording") is not None
    return _Waiting(
        [record for record, _ in chosen],
        [name for _, name in chosen],
        in_force,
        report.input_digest if report is not None else None,
        judged,
    )


def _passes(context: JobContext, waiting: _Waiting) -> tuple[list[Pass], dict[tuple[str, int], str]]:
    """Return the passes of the windows, and the reasons of windows that hold none; one window at a time in memory."""
    settings, step = context.setting(EstimationSettings), context.setting(AlignmentSettings).pass_step
    found: list[Pass] = []
    refused: dict[tuple[str, int], str] = {}
    for done, (record, name) in enumerate(zip(waiting.records, waiting.lives, strict=True)):
        context.checkpoint(done, len(waiting.records))
        gated = gate(record.quality, record.track_section, settings)
        made, reason = ((), gated.reason) if gated is not None else _examined(context, record, settings)
        found += [reduced(item, name, step) for item in made]
        if not made:
            refused[record.wheelset, record.start_ns] = reason
    return found, refused


def _examined(context: JobContext, record: WindowRecord, settings: EstimationSettings) -> tuple[Sequence[Pass], str]:
    with context.storage.read() as unit:
        mounting = unit.registry.mounting_at(record.vehicle, record.axle, record.start_ns)
        try:
            window = unit.windows.load(record.wheelset, record.start_ns)
        except DamagedError as error:
            return (), str(error)  # names the file; the other windows go on
    turned = mounting is not None and mounting.reversed
    examined = examine(window, settings, mounted_reversed=turned)
    return examined.passes, examined.outcome.reason
