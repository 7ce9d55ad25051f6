"""Windows of an epoch to passes, or the reasons why they hold none."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from estimation.errors import DamagedError
from estimation.jobs.job import JobContext
from estimation.jobs.settings import EstimationSettings
from estimation.jobs.steps.load_window import load_window
from estimation.jobs.steps.vehicle_classes import ClassLookup
from estimation.motion.checks import gate
from estimation.motion.joined_windows import following, joined
from estimation.motion.usable_samples import straight_part
from estimation.track.examination import examine
from estimation.track.partition import Entry
from estimation.track.pass_grid import resampled
from estimation.track.passes import Pass
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window, WindowRecord

WindowKey = tuple[str, int]  # wheelset, start


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

    Parameters
    ----------
    context
        Storage and settings.
    chosen
        Windows with the life of their profiles.
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


def _examined(
    context: JobContext, records: Sequence[WindowRecord], settings: EstimationSettings
) -> list[tuple[tuple[WindowKey, ...], Sequence[Pass], Reason | None]]:
    """Return windows that follow each other, their passes, and why there is none."""
    windows: list[Window] = []
    found: list[tuple[tuple[WindowKey, ...], Sequence[Pass], Reason | None]] = []
    with context.storage.read() as unit:
        assumed = ClassLookup(unit, settings).assumed(records[0].vehicle, records[0].wheelset)
        if isinstance(assumed, Reason):
            return [(((record.wheelset, record.start_ns),), (), assumed) for record in records]
        mounting = unit.registry.mounting_at(records[0].vehicle, records[0].axle, records[0].start_ns)
        section = records[0].track_section
        layout = unit.tracks.layout(section) if section is not None else None
        for record in records:
            try:
                window = load_window(unit, record, assumed.windows.vehicle_class)
            except DamagedError as error:  # names the file; the other windows go on
                window = Reason(ReasonCode.FILE_DAMAGED, str(error))
            if not isinstance(window, Reason):
                window = straight_part(window, layout, settings.signals)
            if isinstance(window, Reason):
                found.append((((record.wheelset, record.start_ns),), (), window))
            else:
                windows.append(window)
    turned = mounting is not None and mounting.reversed
    keys = [(w.sample_interval_s, w.start_ns, w.start_ns + w.length_ns) for w in windows]
    for group in following(windows, keys):
        examined = examine(joined(group), assumed.windows, mounted_reversed=turned)
        serials = tuple((window.wheelset, window.start_ns) for window in group)
        found.append((serials, examined.passes, examined.outcome.reason))
    return found
