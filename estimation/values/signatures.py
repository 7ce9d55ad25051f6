"""Wear signatures: spectra of a wheelset's raw signals over a place, and what is concluded from them.

The signals are y, R = rL - rR as the yaw sensor gives it, and the roll: lateral, yaw and roll acceleration integrated
along the track. Their spectra are those of the accelerations over known powers of speed and wavelength.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Final

import numpy as np

from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason

SIGNALS = 3  # y, R, roll
POWERS, CROSSES = 3, 6  # columns of ``Signature.spectra``: powers of the signals, then Re and Im of their products
METHOD: Final = "signature"


class AxlePosition(StrEnum):
    """Where a wheelset runs in its bogie; the same wheels move otherwise in front than behind."""

    SINGLE = "single"
    LEADING = "leading"
    TRAILING = "trailing"


@dataclass(frozen=True, slots=True, order=True)
class Place:
    """A stretch of a section: its number, from the section's zero point."""

    section: str
    cell: int


@dataclass(frozen=True, slots=True)
class Signature(FrozenArrays):
    """Spectra of one wheelset over one place, or over as long a stretch that nobody knows the place of.

    Columns of ``spectra``: powers of y, R and roll (m2, m2, rad2), then real and imaginary part of the cross-spectra
    y R, y roll, R roll; rows are bands, from the longest wavelength to the shortest.
    """

    wheelset: str
    vehicle: str
    vehicle_class: str
    position: AxlePosition
    start_ns: int  # of its window
    order: int  # of the stretch within its window
    place: Place | None
    speed: float  # m/s, mean
    spectra: Annotated[FloatArray, None, POWERS + CROSSES]
    peak_wavelength: float  # m, of R: Klingel's, shifted by the track

    @property
    def finite(self) -> bool:
        """Whether all spectra are finite and no power is zero, so that their logarithms are finite, too."""
        known = np.isfinite(self.spectra).all() and np.isfinite([self.speed, self.peak_wavelength]).all()
        return bool(known and (self.spectra[:, :POWERS] > 0.0).all())

    @property
    def powers(self) -> FloatArray:
        """Logarithms of the powers (3 b,), signal after signal."""
        return np.log(self.spectra[:, :POWERS]).T.ravel()


class ConicitySource(StrEnum):
    """How the fleet knows the conicity of a library entry."""

    GEOMETRY = "geometry"
    MEASURED_PROFILES = "measured_profiles"


@dataclass(frozen=True, slots=True)
class DesignPair:
    """Design profiles of wheel and rail: what a conicity looks like depends on both."""

    wheel: str
    rail: str | None  # with its inclination; None where nobody knows on which rails a wheelset ran


NO_PAIR = DesignPair("", None)  # of entries all of which are of one design


@dataclass(frozen=True, slots=True)
class LibraryEntry:
    """A signature of a wheelset of known conicity at 3 mm, of the same profiles."""

    signature: Signature
    baseline: int  # reprofilings before it
    conicity: float
    std: float
    source: ConicitySource
    shares_data: tuple[str, ...] = ()  # wheelsets whose samples went into the signature or the conicity, its own too
    pair: DesignPair = NO_PAIR

    @property
    def wheelset(self) -> str:
        """Serial."""
        return self.signature.wheelset


@dataclass(frozen=True, slots=True)
class UsedEntry:
    """A wheelset of the library on a section, and how much it counts for an answer."""

    wheelset: str
    section: str
    conicity: float
    weight: float  # shares of all used entries; their sum is at most 1
    source: ConicitySource


@dataclass(frozen=True, slots=True)
class StateProbability:
    """Probability that the conicity at 3 mm is within [low, high)."""

    low: float
    high: float
    probability: float


class Basis(StrEnum):
    """What the library knows of where the judged wheelset ran."""

    SAME_PLACES = "same_places"  # the library has the places: their track cancels
    OTHER_PLACES = "other_places"  # it has the like of them: their track is one more unknown


@dataclass(frozen=True, slots=True)
class SignatureAnswer:
    """What the library says of a wheelset. Where ``conicity`` is not estimated nothing else is said."""

    wheelset: str
    conicity: Estimate  # equivalent, at 3 mm; ``count`` is of signatures
    basis: Basis | None = None
    states: tuple[StateProbability, ...] = ()
    used: tuple[UsedEntry, ...] = ()
    library_wheelsets: int = 0
    library_sections: int = 0
    novelty: float | None = None  # distance from the library over the largest that is answered


@dataclass(frozen=True, slots=True)
class Retired:
    """A library entry that is not used any more, and why."""

    entry: LibraryEntry
    reason: Reason


@dataclass(frozen=True, slots=True)
class Disagreement:
    """How far the answer of the signatures is from that of the geometry."""

    difference: float
    std: float
    disagrees: bool
    reason: Reason | None = None


@dataclass(frozen=True, slots=True)
class WindowSignatures:
    """What became of a window: its signatures, or why it has none."""

    wheelset: str
    start_ns: int
    vehicle: str
    window_digest: str  # of the samples
    assumed: str  # digest of class, parameters and layout
    signatures: tuple[Signature, ...]
    reason: Reason | None = None


@dataclass(frozen=True, slots=True)
class KnownSignatures:
    """Signatures of a window whose mileage is believed, with that."""

    found: WindowSignatures
    mileage_km: float


@dataclass(frozen=True, slots=True)
class StoredSignatures:
    """What is stored of windows and known, and of which it cannot be read: wheelset, start, and what is wrong."""

    known: Sequence[KnownSignatures]
    damaged: Sequence[tuple[str, int, str]] = ()


@dataclass(frozen=True, slots=True)
class SignatureRecord:
    """The newest answer about a wheelset, with its provenance, beside what its geometry says."""

    answer: SignatureAnswer
    baseline: int
    signatures: int  # that were judged
    from_ns: int | None
    to_ns: int | None
    left_out: Mapping[str, int]  # library entries that do not count for this wheelset, by code of the reason
    geometry: Estimate | None  # conicity at 3 mm by the geometry, of the same baseline; None without one
    disagreement: Disagreement | None
    input_digest: str
    code_version: str
    recorded_ns: int

    @property
    def wheelset(self) -> str:
        """Serial."""
        return self.answer.wheelset
