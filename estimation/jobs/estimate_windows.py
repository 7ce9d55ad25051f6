"""Job: pending windows become bin tables, or are refused with their reason; one that is damaged is refused too."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from functools import lru_cache

from estimation.errors import DamagedError
from estimation.jobs.job import Job, JobContext
from estimation.ports import UnitOfWork, WindowRecord, WindowState
from estimation.settings import EstimationSettings
from estimation.signals import Refusal
from estimation.types import BinTable, TrackAlignment
from estimation.window_table import NO_ALIGNMENT, tabulate_window


def run(context: JobContext) -> Mapping[str, int]:
    """Estimate every pending window; each batch is committed together."""
    settings = context.setting(EstimationSettings)
    counts: Counter[str] = Counter(estimated=0, refused=0, changed_meanwhile=0)
    with context.storage.write() as unit:
        counts["requeued"] = _requeue(unit, settings)
        total = unit.windows.counts().get(WindowState.PENDING, 0)
    done = 0
    while batch := _compute(context, settings):
        with context.storage.write() as unit:
            for record, outcome, track in batch:
                counts[_store(unit, record, outcome, track)] += 1
        done += len(batch)
        context.checkpoint(done, max(total, done))
    return counts


JOB = Job("estimate_windows", "Reduce pending windows to bin tables", every_s=60.0, run=run)

_Outcome = tuple[WindowRecord, BinTable | Refusal, TrackAlignment | None]


def _requeue(unit: UnitOfWork, settings: EstimationSettings) -> int:
    """Let windows wait again that an alignment has come for, or whose table is of another alignment or parameters."""
    known = {section.code: unit.tracks.alignment(section.code) for section in unit.tracks.sections()}
    versions = {code: track.version for code, track in known.items() if track is not None}
    outdated = unit.tables.outdated(settings.bins.key, versions)
    for wheelset, start_ns in outdated:
        unit.windows.mark(wheelset, start_ns, WindowState.PENDING, "")
    return len(outdated) + sum(unit.windows.requeue(code, NO_ALIGNMENT) for code in versions)


def _compute(context: JobContext, settings: EstimationSettings) -> list[_Outcome]:
    with context.storage.read() as unit:

        @lru_cache
        def alignment(section: str | None) -> TrackAlignment | None:
            return unit.tracks.alignment(section) if section is not None else None

        return [
            (record, _outcome(unit, record, alignment(record.track_section), settings), alignment(record.track_section))
            for record in unit.windows.pending(settings.batch)
        ]


def _outcome(
    unit: UnitOfWork, record: WindowRecord, track: TrackAlignment | None, settings: EstimationSettings
) -> BinTable | Refusal:
    try:
        window = unit.windows.load(record.wheelset, record.start_ns)
    except DamagedError as error:
        return Refusal(str(error))  # names the file; the other windows go on
    return tabulate_window(window, track, settings)


def _store(unit: UnitOfWork, record: WindowRecord, outcome: BinTable | Refusal, track: TrackAlignment | None) -> str:
    now = unit.windows.get(record.wheelset, record.start_ns)
    if now is None or now.content_digest != record.content_digest:
        return "changed_meanwhile"  # still pending: the next batch takes it
    if isinstance(outcome, Refusal):
        unit.windows.mark(record.wheelset, record.start_ns, WindowState.REFUSED, outcome.reason)
        return "refused"
    version = track.version if track is not None else None
    unit.tables.put(record.wheelset, record.start_ns, outcome, version, record.content_digest)
    unit.windows.mark(record.wheelset, record.start_ns, WindowState.ESTIMATED, "")
    return "estimated"
