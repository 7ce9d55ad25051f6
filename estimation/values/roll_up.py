"""Roll-ups: what the windows of a mileage interval have in common, as sums to which a window is added once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from estimation.values.arrays import FloatArray, IntArray
from estimation.values.geometry import BinTable, FilledCells
from estimation.values.windows import WindowRecord

CONTENT_BITS = 256


class Side(IntEnum):
    """On which side of an identity change windows are; they are never merged across it."""

    WHOLE = 0  # there was no change
    BEFORE = 1
    AFTER = 2


@dataclass(frozen=True, slots=True, order=True)
class RollUpKey:
    """Which windows of a wheelset are summed up together."""

    baseline: int  # reprofilings before it
    interval: int  # of mileage since the baseline
    side: Side
    table_key: str  # of the bin tables
    vehicle_class: str  # code


@dataclass(frozen=True, slots=True)
class TabledWindow:
    """A window with a bin table, and what is known of the table without reading it."""

    record: WindowRecord
    parameter_key: str
    track_version: int | None
    content_digest: str  # of the table
    rolled: bool = False  # into the sums, or found to belong to none
    roll_up: int | None = None  # number of the roll-up; None where it is in none
    running_km: float | None = None  # mileage with which it was rolled
    samples_purged: bool = False  # it cannot be estimated again


@dataclass(frozen=True, slots=True)
class Member:
    """A window as part of a roll-up."""

    window: TabledWindow
    mileage_km: float  # that the wheelset had run, whatever its odometer did
    line: str  # digest of all that shapes its share, 64 hexadecimal digits
    forgetting: float  # its weight against the end of the interval

    @property
    def start_ns(self) -> int:
        """Start of the window."""
        return self.window.record.start_ns


@dataclass(frozen=True, slots=True)
class TakenTable:
    """A table that was replaced or removed after it had been rolled: it is to be taken away from its roll-up."""

    number: int
    roll_up: int  # number of the roll-up
    start_ns: int
    mileage_km: float
    line: str
    cells: FilledCells


@dataclass(frozen=True, slots=True)
class RollUp:
    """What is known of the windows of one key without their sums.

    Mileages are integers, so that their sums do not depend on the order either. ``content`` is the sum of the digests
    of its windows modulo 2^256: the same windows give the same number in any order.
    """

    key: RollUpKey
    number: int | None = None  # under which it is stored
    windows: int = 0
    content: int = 0
    first_ns: int = 0
    last_ns: int = 0  # start of the last window
    end_ns: int = 0  # of the last window
    last_km: float = 0.0  # mileage of the last window
    last_stored_km: float = 0.0  # that the odometer gave
    mileage_mm: int = 0  # sum
    weight: int = 0  # sum of the weights of forgetting, in 2^-40
    weighted_mileage: int = 0  # sum of weight times mileage, 2^-40 mm
    versions: Mapping[str, tuple[int, ...]] = field(default_factory=dict)  # by section, of its alignment, increasing
    vehicles: tuple[str, ...] = ()
    chosen: tuple[tuple[str, int], ...] = ()  # (digest, start) of windows that stand for all, by digest
    sealed: bool = False  # windows and tables may be gone

    @property
    def content_digest(self) -> str:
        """The content as 64 hexadecimal digits."""
        return f"{self.content:064x}"

    @property
    def mean_km(self) -> float:
        """Mean mileage of the windows."""
        return self.mileage_mm / self.windows * 1e-6


WEIGHT_UNIT = 2.0**-40
MILLIMETRES = 1e6  # per km
MOST_CHOSEN = 16


def with_member(roll_up: RollUp, member: Member) -> RollUp:
    """Return the roll-up with one more window."""
    record, weight = member.window.record, round(member.forgetting / WEIGHT_UNIT)
    mileage_mm = round(member.mileage_km * MILLIMETRES)
    empty = roll_up.windows == 0
    last = empty or record.start_ns > roll_up.last_ns
    return replace(
        roll_up,
        windows=roll_up.windows + 1,
        content=(roll_up.content + int(member.line, 16)) % 2**CONTENT_BITS,
        first_ns=record.start_ns if empty else min(roll_up.first_ns, record.start_ns),
        last_ns=record.start_ns if last else roll_up.last_ns,
        end_ns=record.start_ns + record.length_ns if last else roll_up.end_ns,
        last_km=member.mileage_km if last else roll_up.last_km,
        last_stored_km=record.mileage_km if last else roll_up.last_stored_km,
        mileage_mm=roll_up.mileage_mm + mileage_mm,
        weight=roll_up.weight + weight,
        weighted_mileage=roll_up.weighted_mileage + weight * mileage_mm,
        versions=_with_version(roll_up.versions, record.track_section, member.window.track_version),
        vehicles=tuple(sorted({*roll_up.vehicles, record.vehicle})),
        chosen=_with_chosen(roll_up.chosen, member),
    )


def of_members(roll_up: RollUp, members: Sequence[Member]) -> RollUp:
    """Return the roll-up of the same key and number with just these windows.

    Args:
        members: In any order.
    """
    found = RollUp(roll_up.key, roll_up.number, sealed=roll_up.sealed)
    for member in members:
        found = with_member(found, member)
    return found


def _with_version(
    versions: Mapping[str, tuple[int, ...]], section: str | None, version: int | None
) -> Mapping[str, tuple[int, ...]]:
    if section is None or version is None or version in versions.get(section, ()):
        return versions
    return {**versions, section: tuple(sorted({*versions.get(section, ()), version}))}


def _with_chosen(chosen: tuple[tuple[str, int], ...], member: Member) -> tuple[tuple[str, int], ...]:
    """Return the windows of the smallest digests: a choice that does not depend on the order."""
    if member.window.record.quality.hunting.sustained:
        return chosen
    digest = member.window.record.content_digest
    return tuple(sorted({*chosen, (digest, member.start_ns)})[:MOST_CHOSEN])


@dataclass(frozen=True, slots=True)
class Odometer:
    """Where the chain of mileages of a wheelset stands after a window."""

    shift: float  # km by which what it has run is beyond what the odometer says
    last: float  # km, last known reading
    last_km: float  # that it had run then
    last_ns: int  # start of the window of that reading; 0 before the first
    seen_ns: int  # start of the last window, whether it had a reading or not


@dataclass(frozen=True, slots=True)
class RollUpState:
    """What the roll-ups of a wheelset were made by."""

    rules: str  # digest of what says which window belongs where
    classes: Mapping[str, str]  # by vehicle, key of its tables and code of its class
    odometers: Mapping[int, Odometer]  # by baseline, after its last window that was rolled


UnsignedArray = npt.NDArray[np.uint64]
HALF = 64  # bits of each of the two words


@dataclass(frozen=True, slots=True)
class ExactTable:
    """The sum of bin tables as fixed-point numbers, cells by columns: weight, lateral and yaw moments side by side.

    A number is ``(upper * 2^64 + lower) * 2^exponent``.
    """

    parameter_key: str
    edges: FloatArray  # (b + 1,) m
    groups: int
    lateral: int  # columns of the lateral equation
    exponent: int
    upper: IntArray  # (g b, 1 + q + r)
    lower: UnsignedArray  # (g b, 1 + q + r)
    samples: int = 0
    windows: int = 0

    def table(self) -> BinTable:
        """Return the sum, rounded to floating point."""
        values = _rounded(self.upper, self.lower, self.exponent)
        shape = (self.groups, len(self.edges) - 1)
        return BinTable(
            parameter_key=self.parameter_key,
            edges=self.edges,
            weight=values[:, 0].reshape(shape),
            lateral=values[:, 1 : 1 + self.lateral].reshape(*shape, -1),
            yaw=values[:, 1 + self.lateral :].reshape(*shape, -1),
            samples=self.samples,
            windows=self.windows,
        )


@dataclass(frozen=True, slots=True)
class RolledPart:
    """A roll-up with its sums; ``before`` is the digest of its content as it was read."""

    roll_up: RollUp
    before: str
    plain: ExactTable
    forgetting: ExactTable
    added: tuple[Member, ...]


def _rounded(upper: IntArray, lower: UnsignedArray, exponent: int) -> FloatArray:
    """Return the numbers of both words in floating point."""
    negative = upper < 0
    high = np.where(negative, -upper - (lower != 0), upper)
    low = np.where(negative, ~lower + np.uint64(1), lower)
    size = np.ldexp(high.astype(np.float64), exponent + HALF) + np.ldexp(low.astype(np.float64), exponent)
    return np.asarray(np.where(negative, -size, size))


@dataclass(frozen=True, slots=True)
class RollingSums:
    """Sums over pieces of a window, weighted by what the noise of the sensors leaves of the equation."""

    products: FloatArray  # (BANDS, TERMS, TERMS)
    noise: FloatArray  # (BANDS, TERMS, TERMS), of ``products``: what the noise on file makes of it on average


@dataclass(frozen=True, slots=True)
class WindowRollingSums:
    """What a window says of its rolling radius, part by part, and what that was made from."""

    wheelset: str
    start_ns: int
    window_digest: str  # of its content
    assumed: str  # digest of its class and parameters
    parts: tuple[RollingSums, ...]
