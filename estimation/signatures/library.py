"""A library: entries that may be learned from, the regression over them, and how far its answers were off."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.signatures.calibration import Calibration, OnFile, calibrated, differences, judged_by, unjudged
from estimation.signatures.mixed_model import MixedModel, Rows, fitted, levels_between
from estimation.signatures.parameters import SignatureParameters, sharers
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.signatures import AxlePosition, Basis, LibraryEntry, Place


@dataclass(frozen=True, slots=True)
class Library:
    """What may be said of wheelsets of one class and axle position."""

    vehicle_class: str
    position: AxlePosition
    entries: tuple[LibraryEntry, ...]
    places: Mapping[Place, int]  # numbers in the model
    sections: Mapping[str, int]
    model: MixedModel
    conicity: tuple[float, float]  # least and largest
    speed: tuple[float, float]  # m/s
    calibration: Mapping[Basis, Calibration | Reason]
    on_file: OnFile

    @property
    def wheelsets(self) -> int:
        """Number of wheelsets."""
        return len({entry.wheelset for entry in self.entries})

    def levels(self, places: int) -> tuple[float, float]:
        """Return between which levels the mean of some places is where their section is like those of the library.

        It may be as far outside as the outermost section is from the next: so far the calibration has gone, too.
        """
        section = np.array([self.sections[place.section] for place in sorted(self.places, key=self.places.__getitem__)])
        return levels_between(self.model, section, places)


def library(entries: Sequence[LibraryEntry], parameters: SignatureParameters) -> Library | Reason:
    """Return the library of some entries of one class and axle position, or why they make none."""
    ordered = sorted((entry for entry in entries if entry.signature.place is not None), key=_order)
    wheelsets = {entry.wheelset: entry for entry in ordered}
    if len(wheelsets) < parameters.least_wheelsets:
        return Reason(
            ReasonCode.LIBRARY_TOO_SMALL,
            f"the library has {len(wheelsets)} wheelsets of known conicity, {parameters.least_wheelsets} are needed",
        )
    spread = float(np.std([entry.conicity for entry in wheelsets.values()]))
    if spread < parameters.least_spread:
        return Reason(
            ReasonCode.LIBRARY_ALIKE,
            f"the conicities of the library have a standard deviation of {spread:.3f},"
            f" {parameters.least_spread:g} is needed",
        )
    groups = [sharers(entry) for entry in ordered]
    before = unjudged(ordered)
    on_file = judged_by(before, differences(rows_of(ordered, 0.0 * before.own), before, groups, parameters.margin))
    rows = rows_of(ordered, on_file.alone)
    places = {place: number for number, place in enumerate(sorted({_place(entry) for entry in ordered}))}
    sections = {code: number for number, code in enumerate(sorted({place.section for place in places}))}
    speeds = [entry.signature.speed for entry in ordered]
    known = [entry.conicity for entry in ordered]
    return Library(
        vehicle_class=ordered[0].signature.vehicle_class,
        position=ordered[0].signature.position,
        entries=tuple(ordered),
        places=places,
        sections=sections,
        model=fitted(rows),
        conicity=(min(known), max(known)),
        speed=(min(speeds), max(speeds)),
        calibration=calibrated(rows, on_file, groups, parameters),
        on_file=on_file,
    )


def rows_of(entries: Sequence[LibraryEntry], own: FloatArray) -> Rows:
    """Return entries as arrays, their conicities shrunk by what their own errors add to their spread.

    A regressor with errors flattens a regression; what is expected of the true conicity, given the known one, does not
    (R. J. Carroll and others, "Measurement Error in Nonlinear Models", 2006, chapter 4).

    Args:
        own: (n,) std of the errors of the known conicities that are of each wheelset alone.
    """
    names = sorted({entry.wheelset for entry in entries})
    places = sorted({_place(entry) for entry in entries})
    sections = sorted({place.section for place in places})
    known = np.array([entry.conicity for entry in entries])
    expected, variance = _expected(known, own)
    return Rows(
        powers=np.stack([entry.signature.powers for entry in entries]),
        conicity=expected,
        on_file=known,
        speed=np.array([entry.signature.speed for entry in entries]),
        place=_numbers([_place(entry) for entry in entries], places),
        section=_numbers([_place(entry).section for entry in entries], sections),
        wheelset=_numbers([entry.wheelset for entry in entries], names),
        variance=variance / expected**2,
    )


def _expected(known: FloatArray, std: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and variance (n,) of the true conicities, given the known ones."""
    spread = max(float(np.var(known) - np.mean(std**2)), 1e-6)
    mean = float(np.mean(known))
    share = spread / (spread + std**2)
    return np.asarray(mean + (known - mean) * share), np.asarray(share * std**2)


def _numbers(values: Sequence[Hashable], known: Sequence[Hashable]) -> IntArray:
    numbers = {value: number for number, value in enumerate(known)}
    return np.array([numbers[value] for value in values], dtype=np.int64)


def _place(entry: LibraryEntry) -> Place:
    assert entry.signature.place is not None
    return entry.signature.place


def _order(entry: LibraryEntry) -> tuple[str, int, int, Place]:
    return entry.wheelset, entry.signature.start_ns, entry.signature.order, _place(entry)
