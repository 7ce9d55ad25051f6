"""Windows of an epoch to passes, or the reasons why they hold none."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.failures import code_of_error, first_line
from estimation.jobs.isolation import fails_alone
from estimation.jobs.job import JobContext
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.load_window import load_window
from estimation.jobs.steps.vehicle_classes import Assumed, ClassLookup
from estimation.motion.checks import gate
from estimation.motion.usable_samples import straight_part
from estimation.storage import UnitOfWork
from estimation.track.examination import examine, following, joined
from estimation.track.gridded_pass import resampled
from estimation.track.partition import Entry
from estimation.track.passes import Pass
from estimation.values.reasons import Reason
from estimation.values.track import TrackLayout
from estimation.values.windows import Window, WindowRecord

WindowKey = tuple[str, int]  # wheelset, start
_Found = tuple[tuple[WindowKey, ...], Sequence[Pass], Reason | None]  # windows, their passes, why there is none

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


def epoch_passes(context: JobContext, chosen: Sequence[Entry]) -> EpochPasses:
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
    for group in following(clean, keys):
        context.checkpoint(done, len(chosen))
        done += len(group)
        for serials, made, reason in _examined(context, [record for record, _ in group], settings):
            found += [resampled(item, group[0][1], step) for item in made]
            members[serials[0]] = serials
            if not made and reason is not None:
                refused |= dict.fromkeys(serials, reason)
    return EpochPasses(found, members, refused)


def _examined(context: JobContext, records: Sequence[WindowRecord], settings: EstimationSettings) -> list[_Found]:
    """Return windows that follow each other, their passes, and why there is none."""
    windows: list[Window] = []
    found: list[_Found] = []
    with context.storage.read() as unit:
        assumed = ClassLookup(unit, settings).assumed(records[0].vehicle, records[0].wheelset)
        if isinstance(assumed, Reason):
            return [(((record.wheelset, record.start_ns),), (), assumed) for record in records]
        mounting = unit.registry.mounting_at(records[0].vehicle, records[0].axle, records[0].start_ns)
        section = records[0].track_section
        layout = unit.tracks.layout(section) if section is not None else None
        for record in records:
            window = _loaded(unit, record, assumed, layout, settings)
            if isinstance(window, Reason):
                found.append((((record.wheelset, record.start_ns),), (), window))
            else:
                windows.append(window)
    turned = mounting is not None and mounting.reversed
    keys = [((w.sample_interval_s, w.backwards), w.start_ns, w.start_ns + w.length_ns) for w in windows]
    for group in following(windows, keys):
        found += _passes_of(group, assumed, mounted_reversed=turned)
    return found


def _loaded(
    unit: UnitOfWork, record: WindowRecord, assumed: Assumed, layout: TrackLayout | None, settings: EstimationSettings
) -> Window | Reason:
    """Return the part of a window that is examined, or why there is none; whatever fails, the other windows go on."""
    try:
        window = load_window(unit, record, assumed.windows.vehicle_class)
        return window if isinstance(window, Reason) else straight_part(window, layout, settings.signals)
    except Exception as error:
        if not fails_alone(error):
            raise
        return Reason(code_of_error(error), first_line(error))


def _passes_of(group: Sequence[Window], assumed: Assumed, *, mounted_reversed: bool) -> list[_Found]:
    """Return the passes of windows that are one run; where that fails, of each alone."""
    serials = tuple((window.wheelset, window.start_ns) for window in group)
    try:
        examined = examine(joined(group), assumed.windows, mounted_reversed=mounted_reversed)
    except Exception as error:
        if not fails_alone(error):
            raise
        if len(group) == 1:
            _log.exception("window %s@%d could not be examined", *serials[0])
            return [(serials, (), Reason(code_of_error(error), first_line(error)))]
        return [one for w in group for one in _passes_of([w], assumed, mounted_reversed=mounted_reversed)]
    return [(serials, examined.passes, examined.outcome.reason)]
