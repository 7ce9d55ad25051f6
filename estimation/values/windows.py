"""Windows of samples, what is stored of them and became of them. SI; int64 ns UTC on the vehicle's clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, FrozenArrays, IntArray
from estimation.values.fields import Served
from estimation.values.reasons import Reason
from estimation.values.units import KM_H_IN_M_S


@dataclass(frozen=True, slots=True)
class SustainedParameters:
    """From which share of a window's running time on it is one of hunting, or of a wheel with a flat."""

    hunting_share: float = 0.5
    blows_share: float = 0.5


SUSTAINED = SustainedParameters()


@dataclass(frozen=True, slots=True)
class Hunting:
    """Sustained swaying of a wheelset at its own wavelength, over some running time."""

    share: float  # of the running time, 0 to 1
    frequency_hz: float  # 0 where the wheelset does not hunt
    amplitude: float  # m, of the lateral displacement; less than the true one where the sensor clips

    @property
    def sustained(self) -> bool:
        """Whether it lasts for most of the time."""
        return self.share >= SUSTAINED.hunting_share


NOT_HUNTING = Hunting(0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class TurnBlows:
    """Blows on the axle box once a turn of the wheel, over some running time: a wheel with a flat."""

    share: float  # of the running time, 0 to 1
    size: float  # m/s2, median of the lateral acceleration; less than the true one where the sensor clips
    turn_m: float  # run between two blows; 0 where there are none
    side: int  # 1 the vehicle's left wheel, -1 its right one, 0 not known

    @property
    def sustained(self) -> bool:
        """Whether they last for most of the time."""
        return self.share >= SUSTAINED.blows_share


NO_BLOWS = TurnBlows(0.0, 0.0, 0.0, 0)


@dataclass(frozen=True, slots=True)
class WindowQuality:
    """What gates look at before a window is estimated."""

    coverage: Annotated[float, Served("Share of the window that has samples.", "coverage_1", finite=False)]
    longest_gap_s: Annotated[float, Served("Longest gap.", finite=False)]
    gaps: Annotated[int, Served("Number of gaps.")]
    # with the clipping bit, or a raw value at its limit
    clipped: Annotated[float, Served("Share of samples at the end of a sensor's range.", "clipped_1", finite=False)]
    invalid: Annotated[float, Served("Share of samples that are marked invalid.", "invalid_1", finite=False)]
    speed_min_m_s: Annotated[float, Served("Lowest speed.", "speed_min_km_h", KM_H_IN_M_S, finite=False)]
    speed_max_m_s: Annotated[float, Served("Highest speed.", "speed_max_km_h", KM_H_IN_M_S, finite=False)]
    position_quality: Annotated[
        float, Served("Share of the window whose position is known.", "position_quality_1", finite=False)
    ]
    sensor_fault: Annotated[bool, Served("Whether a sensor reports a fault.")]  # or an emergency was sent
    hunting: Hunting = NOT_HUNTING  # found from all samples, clipped ones too
    blows: TurnBlows = NO_BLOWS  # likewise


@dataclass(frozen=True, slots=True)
class Window(FrozenArrays):
    """A fixed length of running time of one wheelset, on a uniform grid; accelerations are NaN where not ``valid``.

    ``start_ns`` is a multiple of the window length on the vehicle's clock, so that windows do not depend on how
    recordings were cut. ``distance`` is the position of the wheelset (not of the vehicle's antenna) along the track
    section. ``resolution`` holds the SI value of one count of each acceleration, in the order of the fields: the
    accelerations are whole multiples of it. The yaw acceleration of a bogie frame is not measured by the node: it
    follows from both nodes of the bogie, is NaN where either is not valid, and is not stored; nor are
    ``measures_gravity``, which is a fact of the vehicle class, and ``backwards``, which the data show. Where samples
    are ``bridged`` a blow has spoilt the accelerations and a smooth curve is in their place, for the integrals: they
    are valid, and are not used as samples.
    """

    wheelset: str
    vehicle: str
    axle: int  # node number on the bus, 1..N
    start_ns: int
    length_ns: int
    sample_interval_s: float
    lateral_acceleration: Annotated[FloatArray, "n"]  # m/s2
    yaw_acceleration: Annotated[FloatArray, "n"]  # rad/s2
    roll_acceleration: Annotated[FloatArray, "n"]  # rad/s2
    mass_lateral_acceleration: Annotated[FloatArray, "n"]  # m/s2
    speed: Annotated[FloatArray, "n"]  # m/s
    distance: Annotated[FloatArray, "n"]  # m along the section
    valid: Annotated[BoolArray, "n"]
    resolution: tuple[float, float, float, float]
    track_section: str | None
    odometer_m: float  # vehicle odometer at the start of the window
    quality: WindowQuality
    frame_yaw_acceleration: Annotated[FloatArray, "n"] | None = None  # rad/s2, of the bogie frame; None without a bogie
    measures_gravity: bool = False  # lateral accelerations are specific forces: g times the roll is in them
    backwards: bool = False  # the vehicle runs with its rear end first, and yaw has been turned over
    bridged: Annotated[BoolArray, "n"] | None = None  # ; None where none are; not stored


ACCELERATIONS = ("lateral_acceleration", "yaw_acceleration", "roll_acceleration", "mass_lateral_acceleration")


class WindowState(StrEnum):
    """Where a window stands on its way to a bin table."""

    PENDING = "pending"
    ESTIMATED = "estimated"
    REFUSED = "refused"


class PassedOver(StrEnum):
    """What would have changed a window that stays as it is, for its samples or its bin table have been purged."""

    SUPERSEDED = "superseded"  # another alignment or parameters, fuller samples: its table is right as it was made
    CLASS_CHANGED = "class_changed"  # the class of its vehicle, or the radius of its wheelset
    RECORD_CHANGED = "record_changed"  # its mounting or mileage: its table is wrong


class DueStage(StrEnum):
    """Stages that list the windows that they have not made from what these are now."""

    MILEAGES = "mileages"
    TABLES = "tables"
    SUMS = "sums"
    ALIGNMENT = "alignment"


@dataclass(frozen=True, slots=True)
class WindowPosition:
    """Where a window was along its section: true position = measured + offset + scale (measured - middle).

    ``reason`` is why that is not known, None where it is. ``content_digest`` is of the samples that were looked at.
    """

    wheelset: str
    start_ns: int
    content_digest: str
    version: int | None  # of the alignment against which it was found
    offset_m: float = 0.0
    scale: float = 0.0
    middle_m: float = 0.0
    reason: Reason | None = None


WindowKey = tuple[str, int]  # wheelset and start of a window, in vehicle time


class OfWindow:
    """What is of one window of a wheelset."""

    __slots__ = ()
    wheelset: str
    start_ns: int

    @property
    def key(self) -> WindowKey:
        """Wheelset and start."""
        return self.wheelset, self.start_ns


def text_of_key(wheelset: str, start_ns: int) -> str:
    """Return the key of a window as text."""
    return f"{wheelset}@{start_ns}"


def key_of_text(text: str) -> WindowKey:
    """Return wheelset and start of a window from its key as text."""
    wheelset, _, start = text.rpartition("@")
    return wheelset, int(start)


@dataclass(frozen=True, slots=True)
class WindowRecord(OfWindow):
    """A stored window without its samples. Key: (wheelset, start_ns)."""

    wheelset: str
    start_ns: Annotated[int, Served(name="measured_from")]
    length_ns: int
    vehicle: str
    axle: int
    track_section: str | None
    mileage_km: Annotated[float, Served(finite=False)]  # of the wheelset since new, at the start
    quality: WindowQuality
    state: WindowState
    reason: Reason | None
    content_digest: Annotated[str, Served("Digest of the samples: the same digest is the same window.")]  # sha256
    recorded_ns: int
    implausible: Reason | None = None  # why its mileage is not believed
    samples_purged: bool = False


@dataclass(frozen=True, slots=True)
class WindowMark(OfWindow):
    """A window and the state that it is to have."""

    wheelset: str
    start_ns: int
    state: WindowState
    reason: Reason | None = None  # of a refusal


ReadingSpan = tuple[str, int, int]
"""Wheelset, first start and last start of windows, ns."""


@dataclass(frozen=True, slots=True)
class MileageReading:
    """The mileage of a wheelset at the start of a window, and what speaks against it by itself."""

    start_ns: int  # vehicle time
    mileage_km: float  # of the wheelset since new
    odometer_excess_m: float = 0.0  # by which its change differs from the integral of the speed beyond what is allowed
    off_line_m: float = 0.0  # from the line of the section that it reported, by GNSS; 0 within the limit
    refused: Reason | None = None  # why it is not believed, as it was judged last


OF_FRAME = ("frame_yaw", "frame_yaw_rate", "frame_displacement")


@dataclass(frozen=True, slots=True)
class Motion(FrozenArrays):
    """Motion of one wheelset and its suspended mass over one window.

    With ``band_limited`` every lateral and angular signal has lost its wavelengths beyond the cut-off (all through the
    same filter), so that offsets carry no meaning; without, they are absolute. Samples that are not ``valid`` are
    left out. ``block`` numbers the intervals of some seconds from which standard deviations are computed; -1
    where a sample belongs to none.

    ``stiffness_ratio`` is the vehicle's yaw stiffness over creep coefficient, of the assumed one, where that has been
    estimated. Where it is known what the gauge does, ``displacement`` is that at nominal gauge. The yaw spring of a
    wheelset is tied to the frame of its bogie; without one to what does not yaw.
    """

    speed: Annotated[FloatArray, "n"]  # V, m/s
    displacement: Annotated[FloatArray, "n"]  # y - d where EN 15302 means it, m: ``motion.cross_level``
    lateral_velocity: Annotated[FloatArray, "n"]  # y', m/s
    lateral_acceleration: Annotated[FloatArray, "n"]  # y'', m/s2
    yaw: Annotated[FloatArray, "n"]  # psi, rad
    yaw_rate: Annotated[FloatArray, "n"]  # psi', rad/s
    yaw_acceleration: Annotated[FloatArray, "n"]  # psi'', rad/s2
    roll: Annotated[FloatArray, "n"]  # phi, rad
    roll_rate: Annotated[FloatArray, "n"]  # phi', rad/s
    suspension_deflection: Annotated[FloatArray, "n"]  # ym - y, m
    suspension_deflection_rate: Annotated[FloatArray, "n"]  # ym' - y', m/s
    valid: Annotated[BoolArray, "n"]
    block: Annotated[IntArray, "n"]
    band_limited: bool
    stiffness_ratio: float = 1.0
    frame_yaw: Annotated[FloatArray, "n"] | None = None  # rad, of the bogie frame; None without a bogie
    frame_yaw_rate: Annotated[FloatArray, "n"] | None = None  # rad/s
    frame_displacement: Annotated[FloatArray, "n"] | None = None  # m, lateral, of the frame above the axle
    sample_interval_s: float = math.nan  # between samples; what filters over time needs it
    displacement_noise: float = 0.0  # m2, variance of ``displacement`` by the sensors; mean over the valid samples

    def __len__(self) -> int:
        return len(self.valid)


@dataclass(frozen=True, slots=True)
class WindowsOfReason:
    """Windows of one wheelset with one state and one reason."""

    state: WindowState  # of all of them
    reason: Annotated[Reason | None, Served("Why they wait, are refused or give no number, as of the newest of them.")]
    windows: Annotated[int, Served("How many.")]
    newest_ns: Annotated[int, Served("End of the newest of them, on the vehicle's clock.")]


@dataclass(frozen=True, slots=True)
class WithoutEstimate:
    """Why nothing is estimated of a wheelset, and what to do."""

    reason: Reason  # in one sentence
    what_to_do: str  # in sentences; empty where there is nothing to do but to wait
    windows: Annotated[
        tuple[WindowsOfReason, ...], Served("The windows that are counted, the most frequent reason first.", "reasons")
    ]
    from_ns: Annotated[int | None, Served("Begin of the oldest that is counted; null without windows.", "counted_from")]
    last_ns: Annotated[int | None, Served("End of its newest window, whatever became of it.", "last_data_at")]

    def count(self, state: WindowState) -> int:
        """Return how many of the counted windows have a state."""
        return sum(count.windows for count in self.windows if count.state is state)

    @property
    def counted(self) -> int:
        """How many windows were counted."""
        return sum(count.windows for count in self.windows)


def remedies(reasons: Sequence[Reason | None]) -> str:
    """Return what to do about some reasons, each remedy once, in their order."""
    return " ".join(dict.fromkeys(r.code.remedy for r in reasons if r is not None and r.code.remedy))


def fast_enough(speed: FloatArray | float, least_m_s: float) -> BoolArray:
    """Return where a known speed, m/s, of samples or of the mean of a block, is enough for a reader: the one gate."""
    return np.asarray(speed >= least_m_s)
