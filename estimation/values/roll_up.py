"""Roll-ups: what the windows of a mileage interval have in common, added up in the order of vehicle time."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum

from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinTable
from estimation.values.windows import WindowRecord

APART = " of "  # behind the key of its tables, the number of a roll-up that belongs to no key by the present rules
MOST_CHOSEN = 16


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
    running_km: float | None = None  # mileage with which it was looked at last; None before that
    samples_purged: bool = False  # it cannot be estimated again

    @property
    def start_ns(self) -> int:
        """Start of the window."""
        return self.record.start_ns


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
class RollUp:
    """What is known of windows of one key without their sums; ``content`` is the digest of all, oldest first."""

    key: RollUpKey
    number: int | None = None  # under which it is stored
    windows: int = 0
    content: str = ""  # 64 hexadecimal digits
    first_ns: int = 0
    last_ns: int = 0  # start of the last window
    end_ns: int = 0  # of the last window
    last_km: float = 0.0  # mileage of the last window
    last_stored_km: float = 0.0  # that the odometer gave
    mileage_km: float = 0.0  # sum
    weight: float = 0.0  # sum of the weights of forgetting
    weighted_km: float = 0.0  # sum of weight times mileage
    versions: Mapping[str, tuple[int, ...]] = field(default_factory=dict)  # by section, of its alignment, increasing
    vehicles: tuple[str, ...] = ()
    chosen: tuple[tuple[str, int], ...] = ()  # (digest, start) of windows that stand for all, by digest
    sealed: bool = False  # windows and tables may be gone

    @property
    def mean_km(self) -> float:
        """Mean mileage of the windows."""
        return self.mileage_km / self.windows


@dataclass(frozen=True, slots=True)
class RolledPart:
    """A roll-up with its sums; ``before`` is the digest of its content as it was read."""

    roll_up: RollUp
    before: str
    plain: BinTable
    forgetting: BinTable
    added: tuple[Member, ...]


def with_members(roll_up: RollUp, members: Iterable[Member]) -> RollUp:
    """Return the roll-up with more windows, oldest first, behind those that it has; a sealed one may get late ones."""
    for member in members:
        record, weight, version = member.window.record, member.forgetting, member.window.track_version
        empty = roll_up.windows == 0
        last = empty or record.start_ns > roll_up.last_ns
        versions, chosen = roll_up.versions, roll_up.chosen
        if record.track_section is not None and version is not None:
            of_section = {*versions.get(record.track_section, ()), version}
            versions = {**versions, record.track_section: tuple(sorted(of_section))}
        if not record.quality.hunting.sustained:  # those of the smallest digests: any windows have the same chance
            chosen = tuple(sorted({*chosen, (record.content_digest, member.start_ns)})[:MOST_CHOSEN])
        roll_up = replace(
            roll_up,
            windows=roll_up.windows + 1,
            content=hashlib.sha256(f"{roll_up.content} {member.line}".encode()).hexdigest(),
            first_ns=record.start_ns if empty else min(roll_up.first_ns, record.start_ns),
            last_ns=record.start_ns if last else roll_up.last_ns,
            end_ns=record.start_ns + record.length_ns if last else roll_up.end_ns,
            last_km=member.mileage_km if last else roll_up.last_km,
            last_stored_km=record.mileage_km if last else roll_up.last_stored_km,
            mileage_km=roll_up.mileage_km + member.mileage_km,
            weight=roll_up.weight + weight,
            weighted_km=roll_up.weighted_km + weight * member.mileage_km,
            versions=versions,
            vehicles=tuple(sorted({*roll_up.vehicles, record.vehicle})),
            chosen=chosen,
        )
    return roll_up


@dataclass(frozen=True, slots=True)
class Odometer:
    """Where the chain of mileages of a wheelset stands after a window whose odometer had a reading."""

    last: float  # km, the reading
    last_km: float  # that it had run then
    last_ns: int  # start of the window; 0 before the first


@dataclass(frozen=True, slots=True)
class RollUpState:
    """What the roll-ups of a wheelset were made by."""

    rules: str  # digest of what says which window belongs where
    classes: Mapping[str, str]  # by vehicle, key of its tables and code of its class


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
