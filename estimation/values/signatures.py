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
from estimation.values.fields import Served
from estimation.values.quantities import Estimate
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.runs import History, ResultKind, SubjectKind

SIGNALS = 3  # y, R, roll
POWERS, CROSSES = 3, 6  # columns of ``Signature.spectra``: powers of the signals, then Re and Im of their products
METHOD: Final = "signature"
SIGNATURES: Final = "signatures"
"""The stage of signatures, and the facet that a wheelset with other ones has raised."""
OF_OTHERS = (ReasonCode.FRAME_UNKNOWN, ReasonCode.MOUNTING_DIFFERS)
"""What other windows or the registry lack: once the window is estimated they do not."""


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
    conicity: Annotated[float, Served("On file, at 3 mm.", "equivalent_conicity_1")]
    weight: Annotated[float, Served("Share of all entries that were used.")]
    source: Annotated[ConicitySource, Served("How its conicity is known.")]


@dataclass(frozen=True, slots=True)
class StateProbability:
    """Probability that the conicity at 3 mm is within [low, high)."""

    low: Annotated[float, Served("Least equivalent conicity of the state.", "from_1")]
    high: Annotated[float, Served("Where the next state begins; null for the last.", "to_1", finite=False)]
    probability: Annotated[float, Served("That the conicity is in this state.")]


class Basis(StrEnum):
    """What the library knows of where the judged wheelset ran."""

    SAME_PLACES = "same_places"  # the library has the places: their track cancels
    OTHER_PLACES = "other_places"  # it has the like of them: their track is one more unknown


@dataclass(frozen=True, slots=True)
class SignatureAnswer:
    """What the library says of a wheelset. Where ``conicity`` is not estimated nothing else is said."""

    wheelset: Annotated[str, Served(example="WS-0001")]
    conicity: Annotated[
        Estimate, Served("`n_windows` counts signatures: stretches of track.", "equivalent_conicity_at_3_mm_1")
    ]
    basis: Annotated[Basis | None, Served("Whether the library has the places that the wheelset passed.")] = None
    states: Annotated[tuple[StateProbability, ...], Served("All states; empty where nothing is said.")] = ()
    used: tuple[UsedEntry, ...] = ()
    library_wheelsets: Annotated[int, Served("Wheelsets that the library has for this one.")] = 0
    library_sections: Annotated[int, Served("Sections that it has.")] = 0
    novelty: Annotated[float | None, Served("Distance from the library; above 1 nothing is said.")] = None


@dataclass(frozen=True, slots=True)
class Retired:
    """A library entry that is not used any more, and why."""

    entry: LibraryEntry
    reason: Reason


@dataclass(frozen=True, slots=True)
class Disagreement:
    """How far the answer of the signatures is from that of the geometry."""

    difference: Annotated[float, Served("Signature less geometry.", "difference_1")]
    std: Annotated[float, Served("Standard deviation of the difference.", "difference_std_1")]
    disagrees: Annotated[bool, Served("Whether their 95 % intervals are apart: a finding.", "disagree")]
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
class MadeOf:
    """What the signatures of a window are made from, and whether it lacked what others had not brought yet."""

    window_digest: str
    assumed: str
    lacked_others: bool


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
class SignatureFinding:
    """The newest answer about a wheelset, beside what its geometry says."""

    answer: SignatureAnswer
    baseline: Annotated[int, Served("Number of reprofilings before it.")]
    signatures: int  # that were judged
    from_ns: int | None
    to_ns: int | None
    left_out: Annotated[Mapping[str, int], Served("Library entries and windows that do not count, by reason.")]
    geometry: Annotated[
        Estimate | None, Served("What the geometry says; null without one of this profile.", "geometry_at_3_mm_1")
    ]
    disagreement: Annotated[Disagreement | None, Served("Null where one of the two says nothing.", "compared")]

    @property
    def wheelset(self) -> str:
        """Serial."""
        return self.answer.wheelset


ANSWERS = ResultKind("answers", SubjectKind.WHEELSET, SignatureFinding, History.NEWEST)
