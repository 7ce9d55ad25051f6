"""Where the windows of an epoch were along their section, into the store."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from estimation.jobs.steps.epoch_passes import EpochPasses, WindowKey
from estimation.storage import UnitOfWork
from estimation.track.passes import Journey, PassStatus
from estimation.track.update import AlignmentUpdate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import Correction
from estimation.values.windows import WindowMark, WindowPosition, WindowRecord, WindowState


@dataclass(frozen=True, slots=True)
class Solved:
    """Windows, their passes, and what follows from them."""

    records: Sequence[WindowRecord]
    passes: EpochPasses
    update: AlignmentUpdate


@dataclass(frozen=True, slots=True)
class Placing:
    """Windows that are placed on a version; journeys ``alone`` on the one before it."""

    part: Solved
    version: int | None
    alone: Mapping[Journey, Correction]
    waits: bool


def place_windows(unit: UnitOfWork, placing: Placing) -> None:
    """Store where windows were; what was known of the others is forgotten. Those that were elsewhere wait again."""
    found = _positions(placing)
    keys = [(position.wheelset, position.start_ns) for position in found]
    before = unit.tracks.positions(keys)
    changed = unit.tracks.put_positions(found)
    placed = {key: position for key, position in zip(keys, found, strict=True) if key in changed}
    moved = [key for key, position in placed.items() if _moves(position, before.get(key))]
    estimated = [one.key for one in unit.windows.several(moved) if one.state is not WindowState.PENDING]
    unit.windows.mark_all([WindowMark(*key, WindowState.PENDING) for key in estimated])
    unit.tracks.forget_positions_of([record.key for record in placing.part.records if record.key not in set(keys)])


def _moves(position: WindowPosition, before: WindowPosition | None) -> bool:
    """Return whether a window is elsewhere than it was; one that was nowhere was where its vehicle says."""
    was = (before.offset_m, before.scale, before.reason) if before is not None else (0.0, 0.0, None)
    return (position.offset_m, position.scale, position.reason) != was


def _positions(placing: Placing) -> Sequence[WindowPosition]:
    """Return where the windows were, as far as it has been found."""
    epoch, update, waits = placing.part, placing.part.update, placing.waits
    journey_of = _journeys_of_windows(epoch)
    unused = {
        key: outcome
        for item, outcome in zip(epoch.passes.found, update.pass_outcomes, strict=True)
        for key in epoch.passes.windows(item)
        if outcome.reason and key not in journey_of
    }
    contradicted = {key for key, outcome in unused.items() if outcome.status is PassStatus.REFUSED}
    refusals = {**epoch.passes.refused, **{key: outcome.reason for key, outcome in unused.items() if outcome.reason}}
    outliers = {(one.vehicle, one.from_ns): one.reason for one in update.estimate.report.journeys if not one.used}
    corrections = {**update.estimate.corrections, **placing.alone}
    found = []
    for record in epoch.records:
        key = (record.wheelset, record.start_ns)
        uncorrected = WindowPosition(record.wheelset, record.start_ns, record.content_digest, placing.version)
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


def _journeys_of_windows(part: Solved) -> dict[WindowKey, Journey]:
    """Return the journey of every window whose pass was used."""
    return {
        key: journey
        for journey, members in part.update.estimate.grouped.items()
        for item in members
        for key in part.passes.windows(item)
    }


def _corrected(uncorrected: WindowPosition, correction: Correction | None, update: AlignmentUpdate) -> WindowPosition:
    if correction is not None:
        return _moved(uncorrected, correction)
    return uncorrected if update.outcome.positions_valid else replace(uncorrected, reason=_uncertain())


def _uncertain(why: str = "") -> Reason:
    return Reason(ReasonCode.POSITION_UNCERTAIN, f"its position along the section is not certain{why}")


def _moved(uncorrected: WindowPosition, correction: Correction) -> WindowPosition:
    return replace(uncorrected, offset_m=correction.offset, scale=correction.scale, middle_m=correction.middle)
