"""Which passes of a section are used: each is used, or refused with its reason.

First by itself: long enough for the filter. Then against what is known of the place, the alignment and the other
journeys. Where passes contradict each other, those of more journeys are used; where as many stand on both sides, none
is. Where the position of a vehicle jumped, the passes behind the jump are displaced against those before it, by the
shifts at which passes agree; the longer part is used.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph
from scipy.sparse.linalg import spsolve

from estimation.track.parameters import TRACK
from estimation.track.passes import Pass, PassOutcome, PassStatus, journeys
from estimation.track.screening.agreement import (
    FilteredPass,
    ScreeningParameters,
    agreement,
    alignment_segment,
    disagreement,
    filter_pass,
)
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import TrackAlignment


@dataclass(frozen=True, slots=True)
class Link:
    """Two passes, by index, that agree where the first is displaced by ``shift`` m against the second."""

    first: int
    second: int
    shift: float  # m


def misplaced(links: Sequence[Link], journey_of: IntArray, middle: FloatArray, tolerance: float) -> Mapping[int, float]:
    """Return by pass how far it is from the rest of its journey, m, where its position jumped.

    Neighbours in a journey may differ by ``tolerance``, m, besides the scale of an odometer. ``middle`` (n,) is along
    the section, m.
    """
    if not links:
        return {}
    offset, group = _offsets(links, len(journey_of))
    linked = np.unique([(link.first, link.second) for link in links])
    found: dict[int, float] = {}
    for journey, together in sorted({(int(journey_of[i]), int(group[i])) for i in linked}):
        members = [int(i) for i in linked if journey_of[i] == journey and group[i] == together]
        parts = _parts(sorted(members, key=lambda i: (middle[i], i)), offset, middle, tolerance)
        main = max(parts, key=len)
        for part in parts:
            if part is not main:
                found |= {i: float(offset[i] - np.median(offset[main])) for i in part}
    return found


def _offsets(links: Sequence[Link], count: int) -> tuple[FloatArray, IntArray]:
    """Return the displacement of each pass (count,) along the section, m, and its group."""
    # Fitted by least absolute values. Groups are what links join; offsets of different groups cannot be compared.
    rows = np.arange(len(links))
    first, second = np.array([link.first for link in links]), np.array([link.second for link in links])
    shift = np.array([link.shift for link in links])
    ones = np.ones(len(links))
    design = sparse.csr_matrix(
        (np.concatenate([ones, -ones]), (np.concatenate([rows, rows]), np.concatenate([first, second]))),
        shape=(len(links), count),
    )
    joined = sparse.csr_matrix((ones, (first, second)), shape=(count, count))
    group = np.asarray(csgraph.connected_components(joined)[1], dtype=np.int64)
    weights = ones
    offset = np.zeros(count)
    for _ in range(TRACK.screening_rounds):
        weighted = sparse.diags(weights) @ design
        normal = (weighted.T @ design + TRACK.anchor_weight * sparse.identity(count)).tocsc()
        offset = np.asarray(spsolve(normal, weighted.T @ shift))
        weights = np.reciprocal(np.maximum(np.abs(shift - design @ offset), TRACK.shift_resolution))
    return offset, group


def _parts(ordered: Sequence[int], offset: FloatArray, middle: FloatArray, tolerance: float) -> list[list[int]]:
    parts: list[list[int]] = []
    for i in ordered:
        for part in reversed(parts):
            allowed = tolerance + TRACK.odometer_scale * abs(middle[i] - middle[part[-1]])
            if abs(offset[i] - float(np.median(offset[part[-5:]]))) <= allowed:
                part.append(i)
                break
        else:
            parts.append([i])
    return parts


@dataclass(frozen=True, slots=True)
class Comparison(Link):
    """Two passes; they agree where there is no reason against it."""

    reason: Reason | None


def compare_pairs(
    filtered: Mapping[int, FilteredPass], journey_of: IntArray, p: ScreeningParameters
) -> list[Comparison]:
    """Return the comparisons of every pass with up to ``p.peers`` that overlap it most, of as many other journeys.

    The cost is linear in the number of passes. Those of one journey (``journey_of`` (n,)) share their errors.
    """
    pairs = {(min(i, j), max(i, j)) for i in filtered for j in _peers(i, filtered, journey_of, p.peers, p)}
    comparisons = []
    for i, j in sorted(pairs):
        agreed = agreement(filtered[i], filtered[j], p.positions.largest_offset, p.cutoff_wavelength, p)
        if agreed.samples >= p.least_samples or agreed.log10_chance <= p.log10_chance:
            reason = disagreement(agreed, 1.0, p, "other passes of the place")
            comparisons.append(Comparison(i, j, agreed.shift, reason))
    return comparisons


def _peers(
    i: int, filtered: Mapping[int, FilteredPass], journey_of: IntArray, wanted: int, parameters: ScreeningParameters
) -> list[int]:
    """Return the passes to compare ``i`` with: of each other journey the one that overlaps it most, those that do best.

    Wheelsets of one vehicle overlap alike; ``i`` decides among them, so that not all are compared with the same one.
    Besides, a few that overlap less and continue along the section, so that comparisons do not end where windows do.
    """
    others = np.array(list(filtered), dtype=np.int64)
    first = np.array([item.first for item in filtered.values()])
    last = np.array([item.last for item in filtered.values()])
    shared = (np.minimum(last, filtered[i].last) - np.maximum(first, filtered[i].first)) // parameters.overlap_step
    order = np.lexsort(((others - i) % len(journey_of), -shared))
    chosen: dict[int, int] = {}  # by journey
    for k in order[shared[order] > 0]:
        chosen.setdefault(int(journey_of[others[k]]), int(others[k]))
    chosen.pop(int(journey_of[i]), None)
    best = list(chosen.values())[:wanted]
    chained = (journey_of[others] != journey_of[i]) & (shared >= parameters.min_chain_overlap)
    beyond = np.where(chained, last - filtered[i].last, 0)
    following = [int(others[k]) for k in np.argsort(-beyond, kind="stable")[: parameters.chain_peers] if beyond[k] > 0]
    return list(dict.fromkeys([*best, *following]))


def minority(
    comparisons: Sequence[Comparison], journey_of: IntArray, confirmed: frozenset[int] = frozenset()
) -> dict[int, Reason]:
    """Return the passes that are contradicted by at least as many journeys as stand with them, with the reason.

    Passes ``confirmed`` by a known alignment are not refused, and whom they contradict is.
    """
    camp = _camps(comparisons, len(journey_of))
    members: dict[int, set[int]] = {}
    for c in comparisons:
        for i in (c.first, c.second):
            members.setdefault(int(camp[i]), set()).add(int(journey_of[i]))
    confirmed_camps = {int(camp[i]) for i in confirmed}
    refused: dict[int, Reason] = {}
    for c in comparisons:
        if c.reason is None or camp[c.first] == camp[c.second]:
            continue
        for i, j in ((c.first, c.second), (c.second, c.first)):
            its_camp, other_camp = int(camp[i]), int(camp[j])
            weaker = len(members[its_camp]) <= len(members[other_camp]) if its_camp not in confirmed_camps else False
            if (weaker or other_camp in confirmed_camps) and i not in confirmed:
                both = len(members[its_camp] | members[other_camp])
                refused[i] = replace(
                    c.reason, text=f"{c.reason}; {len(members[its_camp])} of {both} journeys of the place agree with it"
                )
    return refused


def _camps(comparisons: Sequence[Comparison], count: int) -> IntArray:
    """Return for every pass (count,) the number of the camp that agreements join it to."""
    camp = np.arange(count)

    def head(i: int) -> int:
        while camp[i] != i:
            i = int(camp[i])
        return i

    for c in comparisons:
        if c.reason is None:
            first, second = sorted((head(c.first), head(c.second)))
            camp[second] = first
    return np.array([head(i) for i in range(count)], dtype=np.int64)


@dataclass(frozen=True, slots=True)
class Screened:
    """The passes that may be used, and what became of all of them in the order given."""

    used: tuple[Pass, ...]
    outcomes: tuple[PassOutcome, ...]


def screen(
    passes: Sequence[Pass], known: TrackAlignment | None = None, parameters: ScreeningParameters | None = None
) -> Screened:
    """Return which of the passes of a section may be used."""
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
    agreed, contradicting = _against_known(filtered, known, p)
    known_contradicted = len(contradicting) > len(agreed)  # by most passes: it is left out of the judgement
    if not known_contradicted:
        refused |= contradicting
    grouped = journeys(passes, p.positions).values()
    numbers = {id(item): number for number, members in enumerate(grouped) for item in members}
    journey_of = np.array([numbers[id(item)] for item in passes], dtype=np.int64)
    comparable = {i: one for i, one in filtered.items() if i not in refused}
    comparisons = compare_pairs(comparable, journey_of, p)
    refused |= minority(comparisons, journey_of, frozenset() if known_contradicted else agreed)
    links = [c for c in comparisons if c.reason is None and not {c.first, c.second} & refused.keys()]
    middle = np.array([0.5 * (item.at[0] + item.at[-1]) for item in passes])
    for i, apart in misplaced(links, journey_of, middle, p.misplaced).items():
        refused[i] = Reason(
            ReasonCode.APART_FROM_JOURNEY, f"its position is {abs(apart):.0f} m away from the rest of its journey"
        )
    outcomes = []
    for i, item in enumerate(passes):
        status = PassStatus.REFUSED if i in refused else PassStatus.USED
        status = status if i in filtered else PassStatus.TOO_SHORT
        outcomes.append(PassOutcome(item.wheelset, item.vehicle, item.start_ns, status, refused.get(i)))
    return Screened(tuple(item for i, item in enumerate(passes) if i not in refused), tuple(outcomes))


def _against_known(
    filtered: Mapping[int, FilteredPass], known: TrackAlignment | None, p: ScreeningParameters
) -> tuple[frozenset[int], dict[int, Reason]]:
    if known is None or known.status is not Status.ESTIMATED:
        return frozenset(), {}
    reach = int(p.positions.largest_offset / p.step)
    found = {}
    for i, one in filtered.items():
        track = alignment_segment(known, one.first - reach, one.last + reach, p.cutoff_wavelength, p.step)
        if track is not None:
            found[i] = agreement(one, track, p.positions.largest_offset, p.cutoff_wavelength, p)
    assessed = {i: one for i, one in found.items() if one.samples >= p.least_samples}
    if not assessed:
        return frozenset(), {}
    usual = float(np.median([one.factor for one in assessed.values()]))
    verdicts = {i: disagreement(one, usual or 1.0, p, "the section's alignment") for i, one in assessed.items()}
    refused = {i: reason for i, reason in verdicts.items() if reason is not None}
    return frozenset(assessed.keys() - refused.keys()), refused
