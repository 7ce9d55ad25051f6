"""Windows of an epoch to passes, or the reasons why they hold none; and where each window was."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from estimation.jobs.job import JobContext
from estimation.jobs.parameters import WORK
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.assumptions import Assumed
from estimation.jobs.steps.load_window import WindowLoader
from estimation.jobs.work import fails_alone
from estimation.motion.checks import gate, straight_part
from estimation.storage import UnitOfWork
from estimation.track.gridded_pass import resampled
from estimation.track.iteration import Grouped
from estimation.track.passes import Entry, Journey, Pass, PassStatus, examine, following, joined
from estimation.track.update import AlignmentUpdate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.registry import Mounting, mounting_of
from estimation.values.runs import code_of_error, first_line
from estimation.values.track import Correction, TrackLayout
from estimation.values.windows import Window, WindowKey, WindowMark, WindowPosition, WindowRecord, WindowState

_Found = tuple[tuple[WindowKey, ...], Sequence[Pass], Reason | None]  # windows, their passes, why there is none

"""Windows, of a megabyte each, whose samples are read together."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class EpochPasses:
    """Passes, the windows that each was made of (by its wheelset and start), and why others hold none."""

    found: Sequence[Pass]
    members: Mapping[WindowKey, Sequence[WindowKey]]
    refused: Mapping[WindowKey, Reason]

    def windows(self, item: Pass) -> Sequence[WindowKey]:
        """Return the windows of a pass."""
        return self.members[item.wheelset, item.start_ns]

    def journeys(self, grouped: Grouped) -> dict[WindowKey, Journey]:
        """Return the journey of every window whose pass was used."""
        return {key: journey for journey, members in grouped.items() for item in members for key in self.windows(item)}


@dataclass(frozen=True, slots=True)
class RunsOnFile:
    """What windows of a section are looked at with: by vehicle and wheelset, mountings by vehicle, and the layout."""

    assumed: Mapping[tuple[str, str], Assumed | Reason]
    mountings: Mapping[str, Sequence[Mounting]]
    layout: TrackLayout | None


def epoch_passes(context: JobContext, chosen: Sequence[Entry], on_file: RunsOnFile) -> EpochPasses:
    """Return the passes of windows, and the reasons of those that hold none; a few windows at a time in memory.

    Windows that follow each other are one pass, for its ends are lost to the filter.
    """
    settings, step = context.settings.estimation, context.settings.alignment.pass_step
    found: list[Pass] = []
    members: dict[WindowKey, tuple[WindowKey, ...]] = {}
    refused: dict[WindowKey, Reason] = {}
    clean = []
    for record, name in chosen:
        gated = gate(record.quality, record.track_section, settings.gates)
        if gated is None:
            clean.append((record, name))
        else:
            refused[record.wheelset, record.start_ns] = gated
    keys = [((r.vehicle, r.axle, name), r.start_ns, r.start_ns + r.length_ns) for r, name in clean]
    done = len(refused)
    for groups in _together(following(clean, keys)):
        for group, run in zip(groups, _runs(context, groups, on_file), strict=True):
            context.checkpoint(done, len(chosen))
            done += len(group)
            for serials, made, reason in _examined(run):
                found += [resampled(item, group[0][1], step) for item in made]
                members[serials[0]] = serials
                if not made and reason is not None:
                    refused |= dict.fromkeys(serials, reason)
    return EpochPasses(found, members, refused)


@dataclass(frozen=True, slots=True)
class _Run:
    """The windows of a run with their samples."""

    windows: Sequence[Window]  # as they are examined
    refused: Sequence[_Found]  # of the others, why there is none
    assumed: Assumed | Reason  # what they are looked at with; why they are not
    turned: bool  # whether the wheelset is mounted the other way round


def _together(groups: Iterable[Sequence[Entry]]) -> Iterator[list[Sequence[Entry]]]:
    """Yield runs whose samples are read in one transaction."""
    together: list[Sequence[Entry]] = []
    for group in groups:
        if together and sum(map(len, together)) + len(group) > WORK.passes_in_memory:
            yield together
            together = []
        together.append(group)
    if together:
        yield together


def _runs(context: JobContext, groups: Sequence[Sequence[Entry]], on_file: RunsOnFile) -> list[_Run]:
    records = [record for group in groups for record, _ in group]
    settings = context.settings.estimation
    with context.storage.read() as unit:
        loader = WindowLoader(unit, {record.key: record for record in records})

        def run_of(group: Sequence[Entry]) -> _Run:
            own = [record for record, _ in group]
            first = own[0]
            assumed = on_file.assumed[first.vehicle, first.wheelset]
            if isinstance(assumed, Reason):
                return _Run((), [((record.key,), (), assumed) for record in own], assumed, turned=False)
            mounting = mounting_of(on_file.mountings[first.vehicle], first.axle, first.start_ns)
            loaded = [(record, _loaded(loader, record, assumed, on_file.layout, settings)) for record in own]
            windows = [one for _, one in loaded if not isinstance(one, Reason)]
            refused = [((record.key,), (), one) for record, one in loaded if isinstance(one, Reason)]
            return _Run(windows, refused, assumed, turned=mounting is not None and mounting.reversed)

        return [run_of(group) for group in groups]


def _examined(run: _Run) -> list[_Found]:
    """Return windows that follow each other, their passes, and why there is none."""
    found = list(run.refused)
    if isinstance(run.assumed, Reason):
        return found
    keys = [((w.sample_interval_s, w.backwards), w.start_ns, w.start_ns + w.length_ns) for w in run.windows]
    for group in following(run.windows, keys):
        found += _passes_of(group, run.assumed, mounted_reversed=run.turned)
    return found


def _loaded(
    loader: WindowLoader,
    record: WindowRecord,
    assumed: Assumed,
    layout: TrackLayout | None,
    settings: EstimationSettings,
) -> Window | Reason:
    """Return the part of a window that is examined, or why there is none; whatever fails, the other windows go on."""
    try:
        window = loader.load(record, assumed.window_parameters.vehicle_class)
        return window if isinstance(window, Reason) else straight_part(window, layout, settings.signals)
    except Exception as error:
        if not fails_alone(error):
            raise
        return Reason(code_of_error(error), first_line(error))


def _passes_of(group: Sequence[Window], assumed: Assumed, *, mounted_reversed: bool) -> list[_Found]:
    """Return the passes of windows that are one run; where that fails, of each alone."""
    serials = tuple((window.wheelset, window.start_ns) for window in group)
    try:
        passes, reason = examine(joined(group), assumed.window_parameters, mounted_reversed=mounted_reversed)
    except Exception as error:
        if not fails_alone(error):
            raise
        if len(group) == 1:
            _log.exception("window %s@%d could not be examined", *serials[0])
            return [(serials, (), Reason(code_of_error(error), first_line(error)))]
        return [item for w in group for item in _passes_of([w], assumed, mounted_reversed=mounted_reversed)]
    return [(serials, passes, reason)]


@dataclass(frozen=True, slots=True)
class Solved:
    """Windows, their passes, and what follows from them."""

    records: Sequence[WindowRecord]
    passes: EpochPasses
    update: AlignmentUpdate


def place_windows(
    unit: UnitOfWork,
    part: Solved,
    version: int | None,
    alone: Mapping[Journey, Correction],
    standing: Mapping[WindowKey, WindowRecord],
    *,
    waits: bool,
) -> None:
    """Store where windows were; what was known of the others is forgotten. Those that were elsewhere wait again.

    Args:
        version: On which they are placed, but for the journeys ``alone``, which are on the one before it.
        standing: The windows as they are.
    """
    positions = _positions(part, version, alone, waits=waits)
    found = {(position.wheelset, position.start_ns): position for position in positions}
    before = unit.tracks.put_positions(list(found.values()))
    moved = sorted(key for key, was in before.items() if _moves(found[key], was))
    estimated = [key for key in moved if standing[key].state is not WindowState.PENDING]
    unit.windows.mark_all([WindowMark(*key, WindowState.PENDING) for key in estimated], standing)
    unit.tracks.forget_positions_of([record.key for record in part.records if record.key not in found])


def _moves(position: WindowPosition, before: WindowPosition | None) -> bool:
    """Return whether a window is elsewhere than it was; one that was nowhere was where its vehicle says."""
    was = (before.offset_m, before.scale, before.reason) if before is not None else (0.0, 0.0, None)
    return (position.offset_m, position.scale, position.reason) != was


def _positions(
    epoch: Solved, version: int | None, alone: Mapping[Journey, Correction], *, waits: bool
) -> Sequence[WindowPosition]:
    """Return where the windows were, as far as it has been found."""
    update = epoch.update
    journey_of = epoch.passes.journeys(update.estimate.grouped)
    unused = {
        key: outcome
        for item, outcome in zip(epoch.passes.found, update.pass_outcomes, strict=True)
        for key in epoch.passes.windows(item)
        if outcome.reason and key not in journey_of
    }
    contradicted = {key for key, outcome in unused.items() if outcome.status is PassStatus.REFUSED}
    refusals = {**epoch.passes.refused, **{key: outcome.reason for key, outcome in unused.items() if outcome.reason}}
    outliers = {(one.vehicle, one.from_ns): one.reason for one in update.estimate.report.journeys if not one.used}
    corrections = {**update.estimate.corrections, **alone}
    found = []
    for record in epoch.records:
        key = (record.wheelset, record.start_ns)
        uncorrected = WindowPosition(record.wheelset, record.start_ns, record.content_digest, version)
        if key in refusals and (key in epoch.passes.refused or not waits):
            # on a survey a window needs no pass, unless its pass contradicts the survey
            accepted = update.outcome.positions_valid and key not in contradicted
            found.append(uncorrected if accepted else replace(uncorrected, reason=refusals[key]))
        elif not waits and key in journey_of:
            journey = journey_of[key]
            if journey in outliers and not update.outcome.positions_valid:
                found.append(replace(uncorrected, reason=_uncertain(f": {outliers[journey]}")))
            else:
                found.append(_corrected(uncorrected, corrections.get(journey), update))
    return found


def _corrected(uncorrected: WindowPosition, correction: Correction | None, update: AlignmentUpdate) -> WindowPosition:
    if correction is not None:
        return replace(uncorrected, offset_m=correction.offset, scale=correction.scale, middle_m=correction.middle)
    return uncorrected if update.outcome.positions_valid else replace(uncorrected, reason=_uncertain())


def _uncertain(why: str = "") -> Reason:
    return Reason(ReasonCode.POSITION_UNCERTAIN, f"its position along the section is not certain{why}")
