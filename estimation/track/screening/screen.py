"""Which passes may speak of a section: each is used, or refused with its reason.

First by itself: long enough for the filter. Then against what is known of the place, the alignment and the other
journeys: two vehicles that ran over the same track have felt the same, whatever their wear, and one that did not has
not. Where passes contradict each other the place is with those of more journeys; where as many stand on both sides
nobody is believed. What one pass says never changes what is done with passes that agree with each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from estimation.track.journeys import PositionParameters, journeys
from estimation.track.passes import Pass
from estimation.track.screening.agreement import Agreement, Felt, agreement, felt, laid
from estimation.track.screening.pairwise import compared, contradicted
from estimation.track.screening.position_jumps import Link, misplaced
from estimation.values.arrays import IntArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment


class PassStatus(StrEnum):
    """What became of a pass."""

    USED = "used"
    REFUSED = "refused"
    TOO_SHORT = "too_short"  # for the filter: of no use here, and nothing is said against it


@dataclass(frozen=True, slots=True)
class PassOutcome:
    """What became of the pass of a wheelset in one window; a reason also where only part of it was used."""

    wheelset: str
    vehicle: str
    start_ns: int
    status: PassStatus
    reason: Reason | None = None


@dataclass(frozen=True, slots=True)
class ScreeningParameters:
    """What it takes to be believed."""

    cutoff_wavelength: float = 30.0  # m
    step: float = 1.0  # m
    positions: PositionParameters = field(default_factory=PositionParameters)
    log10_chance: float = -6.0  # of an agreement by chance
    least_samples: float = 50.0  # independent ones, before a want of agreement says anything
    least_factor: float = 0.4  # of y against the y of others, and its inverse the most
    peers: int = 6  # that a pass is compared with
    misplaced: float = 4.0  # m that a position may jump


@dataclass(frozen=True, slots=True)
class Screened:
    """The passes that may be used, and what became of all of them in the order given.

    ``known_contradicted``: most passes contradict the known alignment; then it was left out of the judgement.
    """

    used: tuple[Pass, ...]
    outcomes: tuple[PassOutcome, ...]
    known_contradicted: bool = False


def screen(
    passes: Sequence[Pass], known: TrackAlignment | None = None, parameters: ScreeningParameters | None = None
) -> Screened:
    """Return which of the passes of a section may be used.

    Parameters
    ----------
    passes
        Of one section, at the positions that were measured.
    known
        What is known of its alignment.
    parameters
        What it takes.
    """
    p = parameters or ScreeningParameters()
    signals = [felt(item, p.cutoff_wavelength, p.step) for item in passes]
    refused = {
        i: Reason(
            ReasonCode.PASS_TOO_SHORT,
            f"{item.at[-1] - item.at[0]:.0f} m long, too short for wavelengths up to {p.cutoff_wavelength:g} m",
        )
        for i, (item, one) in enumerate(zip(passes, signals, strict=True))
        if one is None
    }
    heard = {i: one for i, one in enumerate(signals) if one is not None}
    against_known = _by_known(heard, known, p)
    contradicted_known = 2 * len(against_known.refused) > len(against_known.refused) + len(against_known.agreed)
    if not contradicted_known:
        refused |= against_known.refused
    journey_of = _journeys(passes, p)
    open_to_peers = {i: one for i, one in heard.items() if i not in refused}
    comparisons = compared(open_to_peers, journey_of, p.peers, lambda a, b: _compare(a, b, p))
    agreed = frozenset() if contradicted_known else frozenset(against_known.agreed)
    refused |= contradicted(comparisons, journey_of, agreed)
    links = [c.link for c in comparisons if c.agrees and not {c.first, c.second} & refused.keys()]
    middle = np.array([0.5 * (item.at[0] + item.at[-1]) for item in passes])
    for i, apart in misplaced(links, journey_of, middle, p.misplaced).items():
        refused[i] = Reason(
            ReasonCode.APART_FROM_JOURNEY, f"its position is {abs(apart):.0f} m away from the rest of its journey"
        )
    return Screened(
        tuple(item for i, item in enumerate(passes) if i not in refused),
        tuple(_outcome(item, refused.get(i), short=i not in heard) for i, item in enumerate(passes)),
        contradicted_known,
    )


def _outcome(item: Pass, refusal: Reason | None, *, short: bool) -> PassOutcome:
    status = PassStatus.TOO_SHORT if short else PassStatus.REFUSED if refusal else PassStatus.USED
    return PassOutcome(item.wheelset, item.vehicle, item.start_ns, status, refusal)


@dataclass(frozen=True, slots=True)
class _AgainstKnown:
    agreed: Mapping[int, Agreement]
    refused: Mapping[int, Reason]


def _by_known(heard: Mapping[int, Felt], known: TrackAlignment | None, p: ScreeningParameters) -> _AgainstKnown:
    """Return which passes agree with the known alignment and which contradict it; some it says nothing of."""
    if known is None or known.status is not Status.ESTIMATED:
        return _AgainstKnown({}, {})
    reach = int(p.positions.largest_offset / p.step)
    found = {}
    for i, one in heard.items():
        track = laid(known, one.first - reach, one.last + reach, p.cutoff_wavelength, p.step)
        if track is not None:
            found[i] = agreement(one, track, p.positions.largest_offset, p.cutoff_wavelength)
    told = {i: one for i, one in found.items() if one.samples >= p.least_samples}
    usual = float(np.median([one.factor for one in told.values()])) if told else 1.0
    verdicts = {i: _verdict(one, usual or 1.0, p, "the section's alignment") for i, one in told.items()}
    return _AgainstKnown(
        {i: one for i, one in told.items() if verdicts[i] is None},
        {i: reason for i, reason in verdicts.items() if reason is not None},
    )


def _verdict(found: Agreement, usual: float, p: ScreeningParameters, other: str) -> Reason | None:
    """Return why two do not agree; None where they do."""
    if found.log10_chance > p.log10_chance:
        return Reason(
            ReasonCode.OTHER_SECTION,
            f"not of this section: agrees with {other} no more than by chance"
            f" (correlation {found.correlation:.2f} over {found.samples:.0f} independent samples)",
        )
    factor = found.factor / usual
    if factor < 0.0:
        return Reason(
            ReasonCode.MIRRORED, f"the mirror image of {other}: the axes of its sensors, or its direction, are reversed"
        )
    if not p.least_factor <= factor <= 1.0 / p.least_factor:
        return Reason(ReasonCode.SCALE_DIFFERS, f"its lateral displacement is {factor:.2g} times that of {other}")
    return None


def _journeys(passes: Sequence[Pass], p: ScreeningParameters) -> IntArray:
    numbers: dict[int, int] = {}
    for number, members in enumerate(journeys(passes, p.positions).values()):
        numbers |= {id(item): number for item in members}
    return np.array([numbers[id(item)] for item in passes], dtype=np.int64)


def _compare(first: Felt, second: Felt, p: ScreeningParameters) -> tuple[Reason | None, Link | None] | None:
    """Return why two passes contradict each other, or where they agree; None where they share too little."""
    found = agreement(first, second, p.positions.largest_offset, p.cutoff_wavelength)
    if found.samples < p.least_samples and found.log10_chance > p.log10_chance:
        return None
    reason = _verdict(found, 1.0, p, "other passes of the place")
    if reason is not None:
        return reason, None
    return None, Link(0, 0, found.shift)
