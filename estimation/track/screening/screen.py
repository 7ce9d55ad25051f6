"""Which passes of a section are used: each is used, or refused with its reason.

First by itself: long enough for the filter. Then against what is known of the place, the alignment and the other
journeys: two vehicles that ran over the same track have measured the same alignment, whatever their wear. Where passes
contradict each other, those of more journeys are used; where as many stand on both sides, none is. One pass never
changes what is done with passes that agree with each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from estimation.track.journeys import journeys
from estimation.track.passes import Pass
from estimation.track.screening.agreement import Agreement, FilteredPass, agreement, alignment_segment, filter_pass
from estimation.track.screening.disagreement import disagreement
from estimation.track.screening.pairwise import compare_pairs, minority
from estimation.track.screening.parameters import ScreeningParameters
from estimation.track.screening.position_jumps import misplaced
from estimation.values.arrays import IntArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment


class PassStatus(StrEnum):
    """What became of a pass."""

    USED = "used"
    REFUSED = "refused"
    TOO_SHORT = "too_short"  # for the filter: of no use here, but not refused


@dataclass(frozen=True, slots=True)
class PassOutcome:
    """What became of the pass of a wheelset in one window; a reason also where only part of it was used."""

    wheelset: str
    vehicle: str
    start_ns: int
    status: PassStatus
    reason: Reason | None = None


@dataclass(frozen=True, slots=True)
class Screened:
    """The passes that may be used, and what became of all of them in the order given.

    ``known_contradicted``: most passes contradict the known alignment; then it was left out of the judgement.
    """

    used: tuple[Pass, ...]
    outcomes: tuple[PassOutcome, ...]
    known_contradicted: bool


def screen(
    passes: Sequence[Pass], known: TrackAlignment | None = None, parameters: ScreeningParameters | None = None
) -> Screened:
    """Return which of the passes of a section may be used.

    Args:
        passes: Of one section, at the positions that were measured.
        known: What is known of its alignment.
    """
    p = parameters or ScreeningParameters()
    signals = [filter_pass(item, p.cutoff_wavelength, p.step) for item in passes]
    refused = {
        i: Reason(
            ReasonCode.PASS_TOO_SHORT,
            f"{item.at[-1] - item.at[0]:.0f} m long, too short for wavelengths up to {p.cutoff_wavelength:g} m",
        )
        for i, (item, one) in enumerate(zip(passes, signals, strict=True))
        if one is None
    }
    filtered = {i: one for i, one in enumerate(signals) if one is not None}
    against_known = _against_known(filtered, known, p)
    known_contradicted = 2 * len(against_known.refused) > len(against_known.refused) + len(against_known.agreed)
    if not known_contradicted:
        refused |= against_known.refused
    journey_of = _journeys(passes, p)
    comparable = {i: one for i, one in filtered.items() if i not in refused}
    comparisons = compare_pairs(comparable, journey_of, p)
    agreed = frozenset() if known_contradicted else frozenset(against_known.agreed)
    refused |= minority(comparisons, journey_of, agreed)
    links = [c.link for c in comparisons if c.agrees and not {c.first, c.second} & refused.keys()]
    middle = np.array([0.5 * (item.at[0] + item.at[-1]) for item in passes])
    for i, apart in misplaced(links, journey_of, middle, p.misplaced).items():
        refused[i] = Reason(
            ReasonCode.APART_FROM_JOURNEY, f"its position is {abs(apart):.0f} m away from the rest of its journey"
        )
    return Screened(
        tuple(item for i, item in enumerate(passes) if i not in refused),
        tuple(_outcome(item, refused.get(i), short=i not in filtered) for i, item in enumerate(passes)),
        known_contradicted,
    )


def _outcome(item: Pass, refusal: Reason | None, *, short: bool) -> PassOutcome:
    status = PassStatus.TOO_SHORT if short else PassStatus.REFUSED if refusal else PassStatus.USED
    return PassOutcome(item.wheelset, item.vehicle, item.start_ns, status, refusal)


@dataclass(frozen=True, slots=True)
class _AgainstKnown:
    agreed: Mapping[int, Agreement]
    refused: Mapping[int, Reason]


def _against_known(
    filtered: Mapping[int, FilteredPass], known: TrackAlignment | None, p: ScreeningParameters
) -> _AgainstKnown:
    """Return which passes agree with the known alignment and which contradict it; some are not comparable."""
    if known is None or known.status is not Status.ESTIMATED:
        return _AgainstKnown({}, {})
    reach = int(p.positions.largest_offset / p.step)
    found = {}
    for i, one in filtered.items():
        track = alignment_segment(known, one.first - reach, one.last + reach, p.cutoff_wavelength, p.step)
        if track is not None:
            found[i] = agreement(one, track, p.positions.largest_offset, p.cutoff_wavelength)
    assessed = {i: one for i, one in found.items() if one.samples >= p.least_samples}
    if not assessed:
        return _AgainstKnown({}, {})
    usual = float(np.median([one.factor for one in assessed.values()]))
    verdicts = {i: disagreement(one, usual or 1.0, p, "the section's alignment") for i, one in assessed.items()}
    return _AgainstKnown(
        {i: one for i, one in assessed.items() if verdicts[i] is None},
        {i: reason for i, reason in verdicts.items() if reason is not None},
    )


def _journeys(passes: Sequence[Pass], p: ScreeningParameters) -> IntArray:
    numbers: dict[int, int] = {}
    for number, members in enumerate(journeys(passes, p.positions).values()):
        numbers |= {id(item): number for item in members}
    return np.array([numbers[id(item)] for item in passes], dtype=np.int64)
