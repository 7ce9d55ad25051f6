"""Signatures of a wheelset and a library in; its conicity, its state of wear and what they rest on out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr

from estimation.signatures.calibration import NORMAL, Calibration, conicity_grid, outside
from estimation.signatures.library import Library
from estimation.signatures.mixed_model import Rows, level_of, likelihood
from estimation.signatures.parameters import SIGNATURE
from estimation.signatures.window_signatures import SignatureParameters
from estimation.values.arrays import IntArray
from estimation.values.quantities import Estimate, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import (
    Basis,
    ConicitySource,
    Disagreement,
    Place,
    Signature,
    SignatureAnswer,
    StateProbability,
    UsedEntry,
)


def judged(
    wheelset: str, signatures: Sequence[Signature], library: Library, parameters: SignatureParameters
) -> SignatureAnswer:
    """Return what a library says of a wheelset."""
    same = [signature for signature in signatures if signature.place in library.places]
    chosen = same or list(signatures)
    basis = Basis.SAME_PLACES if same else Basis.OTHER_PLACES
    calibration = library.calibration[basis]
    refusal = _refusal(chosen, library, parameters)
    if refusal is not None:
        return _unknown(wheelset, refusal, library)
    if isinstance(calibration, Reason):
        return _unknown(wheelset, calibration, library)
    known = np.array([library.places[one.place] for one in same if one.place is not None]) if same else None
    return _answer(wheelset, chosen, known, library, calibration, basis, parameters)


def _refusal(signatures: Sequence[Signature], library: Library, parameters: SignatureParameters) -> Reason | None:
    if not signatures:
        return Reason(ReasonCode.NO_SIGNATURE, "there is no signature of the wheelset")
    kinds = {(signature.vehicle_class, signature.position) for signature in signatures}
    if kinds != {(library.vehicle_class, library.position)}:
        return Reason(
            ReasonCode.OTHER_VEHICLE_CLASS,
            f"the library is of class {library.vehicle_class}, axle position {library.position}",
        )
    low, high = library.speed[0] - parameters.speed_margin, library.speed[1] + parameters.speed_margin
    speed = float(np.mean([signature.speed for signature in signatures]))
    if not low <= speed <= high:
        text = f"the wheelset ran at {speed:.1f} m/s, the library covers {low:.1f} to {high:.1f} m/s"
        return Reason(ReasonCode.NOT_IN_LIBRARY, text)
    return None


def _answer(
    wheelset: str,
    signatures: Sequence[Signature],
    places: IntArray | None,
    library: Library,
    calibration: Calibration,
    basis: Basis,
    parameters: SignatureParameters,
) -> SignatureAnswer:
    grid = conicity_grid(np.array(library.conicity), parameters.margin)
    likely = likelihood(library.model, _rows(signatures), places, grid)
    novelty = calibration.novelty(likely)
    refusal = None
    if outside(likely, library.conicity, parameters.margin):
        low, high = library.conicity[0] - parameters.margin, library.conicity[1] + parameters.margin
        text = f"the signature is like that of a conicity outside {low:.2f} to {high:.2f}, which the library covers"
        refusal = Reason(ReasonCode.NOT_IN_LIBRARY, text)
    if novelty > 1.0:
        text = f"the signature is {novelty:.1f} times as far from the library as any that it answers"
        refusal = Reason(ReasonCode.NOT_IN_LIBRARY, text)
    if refusal is None and places is None:
        level, (low, high) = level_of(library.model, _rows(signatures), likely.mean), library.levels(len(signatures))
        if not low <= level <= high:  # conicity depends on the amplitude
            text = f"the track is {'rougher' if level > high else 'smoother'} than any that the library has"
            refusal = Reason(ReasonCode.NOT_IN_LIBRARY, text)
    if refusal is not None:
        return _unknown(wheelset, refusal, library, novelty)
    std = calibration.std(likely.std, library.on_file.shared_std(likely.mean))
    half = NORMAL * std
    return SignatureAnswer(
        wheelset=wheelset,
        conicity=Estimate(
            likely.mean, std, likely.mean - half, likely.mean + half, float(len(signatures)), Status.ESTIMATED
        ),
        basis=basis,
        states=states(likely.mean, std, parameters.states),
        used=_used(likely.mean, std, signatures, library, basis),
        library_wheelsets=library.wheelsets,
        library_sections=len(library.sections),
        novelty=novelty,
    )


def states(conicity: float, std: float, ends: Sequence[float]) -> tuple[StateProbability, ...]:
    """Return the probabilities of the states of wear."""
    bounds = [0.0, *ends, float("inf")]
    below = ndtr((np.array([-np.inf, *ends, np.inf]) - conicity) / std)
    return tuple(
        StateProbability(low, high, float(share))
        for low, high, share in zip(bounds[:-1], bounds[1:], np.diff(below), strict=True)
    )


def most_likely(found: Sequence[StateProbability]) -> StateProbability:
    """Return the state of the largest probability."""
    return max(found, key=lambda one: one.probability)


def compared(answer: Estimate, geometry: Estimate) -> Disagreement | None:
    """Return how far signature and geometry are apart; None where one of them says nothing."""
    numbers = (answer.value, answer.low, answer.high, geometry.value, geometry.low, geometry.high)
    if any(number is None for number in numbers) or answer.std is None or geometry.std is None:
        return None
    value, low, high, other, other_low, other_high = (float(number) for number in numbers if number is not None)
    apart = low > other_high or high < other_low
    text = f"the signature shows a conicity of {value:.3f}, the geometry one of {other:.3f}; their intervals are apart"
    return Disagreement(
        difference=value - other,
        std=float(np.hypot(answer.std, geometry.std)),
        disagrees=apart,
        reason=Reason(ReasonCode.METHODS_DISAGREE, text) if apart else None,
    )


def _rows(signatures: Sequence[Signature]) -> Rows:
    n = len(signatures)
    places = {one.place or Place("", -number): number for number, one in enumerate(signatures)}
    codes = ["" if signature.place is None else signature.place.section for signature in signatures]
    sections = sorted(set(codes))
    return Rows(
        powers=np.stack([signature.powers for signature in signatures]),
        conicity=np.full(n, np.nan),
        on_file=np.full(n, np.nan),
        speed=np.array([signature.speed for signature in signatures]),
        place=np.array([places[one.place or Place("", -number)] for number, one in enumerate(signatures)]),
        section=np.array([sections.index(code) for code in codes]),
        wheelset=np.zeros(n, dtype=np.int64),
        variance=np.zeros(n),
    )


def _used(
    conicity: float, std: float, signatures: Sequence[Signature], library: Library, basis: Basis
) -> tuple[UsedEntry, ...]:
    places = {signature.place for signature in signatures}
    weights: dict[tuple[str, str], float] = {}
    about: dict[tuple[str, str], tuple[list[float], ConicitySource]] = {}
    total = 0.0
    for entry in library.entries:
        place = entry.signature.place
        if place is None or (basis is Basis.SAME_PLACES and place not in places):
            continue
        width = float(np.hypot(std, max(entry.std, 0.02)))
        weight = float(np.exp(-0.5 * ((entry.conicity - conicity) / width) ** 2))
        key = (entry.wheelset, place.section)
        weights[key] = weights.get(key, 0.0) + weight
        about.setdefault(key, ([], entry.source))[0].append(entry.conicity)
        total += weight
    nearest = sorted(weights, key=lambda key: (-weights[key], key))[: SIGNATURE.named_entries]
    return tuple(UsedEntry(*key, float(np.mean(about[key][0])), weights[key] / total, about[key][1]) for key in nearest)


def _unknown(wheelset: str, reason: Reason, library: Library, novelty: float | None = None) -> SignatureAnswer:
    return SignatureAnswer(
        wheelset=wheelset,
        conicity=Estimate.unknown(reason),
        library_wheelsets=library.wheelsets,
        library_sections=len(library.sections),
        novelty=novelty,
    )
