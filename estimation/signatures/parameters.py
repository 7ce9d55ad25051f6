"""Parameters of wear signatures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.values.signatures import LibraryEntry


@dataclass(frozen=True, slots=True)
class SignatureParameters:
    """How windows become signatures, and what a library must hold before it answers; lengths in m."""

    step: float = 0.25
    cell: float = 256.0  # of a section
    block: float = 128.0  # of one spectrum; blocks of a cell overlap by half
    wavelengths: tuple[float, ...] = (45.0, 30.0, 20.0, 15.0, 11.0, 8.0, 6.0, 4.5, 3.3)  # ends of the bands
    least_wheelsets: int = 8  # of known conicity
    most_entries: int = 4000  # of one class, axle position and pair of profiles: the newest
    least_sections: int = 3  # for an answer about places that the library does not have
    least_spread: float = 0.015  # std of the conicities of the library
    most_std: float = 0.03  # of a conicity that is learned from
    most_mileage_km: float = 10_000.0  # between a signature and the conicity that it is learned with
    margin: float = 0.01  # of conicity, by which an answer may be outside those of the library
    speed_margin: float = 1.0  # m/s, the same of speed
    states: tuple[float, ...] = (0.10, 0.15, 0.20, 0.25, 0.30, 0.35)  # conicities between seven states of wear

    @property
    def bands(self) -> int:
        """Number of bands of wavelength."""
        return len(self.wavelengths) - 1

    @property
    def wavenumbers(self) -> FloatArray:
        """Ends of the bands (b + 1,), 1/m, increasing."""
        return 1.0 / np.array(self.wavelengths)


FOLDS = 6
ALONE = 12  # families, up to which each of them is a fold of its own


def families(groups: Iterable[frozenset[str]]) -> list[frozenset[str]]:
    """Return groups of wheelsets that share no data with each other, in the order of their first serials."""
    member: dict[str, set[str]] = {}
    for group in set(groups):
        joined = set(group).union(*(member[name] for name in group if name in member))
        member.update(dict.fromkeys(joined, joined))
    return sorted({frozenset(names) for names in member.values()}, key=min)


def folds(entries: Sequence[LibraryEntry]) -> list[frozenset[str]]:
    """Return wheelsets that are left out together, none of whose data are in entries of others.

    In a small library each family is a fold. In a larger one there are six, each with all kinds of conicity.
    """
    known: dict[str, list[float]] = {}
    for entry in entries:
        known.setdefault(entry.wheelset, []).append(entry.conicity)
    found = families(sharers(entry) for entry in entries)
    if len(found) <= ALONE:
        return found
    mean = {name: sum(values) / len(values) for name, values in known.items()}
    ordered = sorted(found, key=lambda names: (min(mean[name] for name in names if name in mean), min(names)))
    return [frozenset().union(*ordered[first::FOLDS]) for first in range(FOLDS)]


def sharers(entry: LibraryEntry) -> frozenset[str]:
    """Return the wheelsets whose samples are in an entry."""
    return frozenset(entry.shares_data) | {entry.wheelset}
