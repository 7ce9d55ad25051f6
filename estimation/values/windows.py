"""Windows of samples, and what is stored of them. SI; times are int64 ns UTC on the vehicle's clock."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from estimation.values.arrays import BoolArray, FloatArray, frozen_array
from estimation.values.reasons import Reason


@dataclass(frozen=True, slots=True)
class Hunting:
    """Sustained swaying of a wheelset at its own wavelength, over some running time."""

    share: float  # of the running time, 0 to 1
    frequency_hz: float  # 0 where the wheelset does not hunt
    amplitude: float  # m, of the lateral displacement; less than the true one where the sensor clips

    @property
    def sustained(self) -> bool:
        """Whether it lasts for most of the time."""
        return self.share >= HUNTING_SHARE


HUNTING_SHARE = 0.5  # of a window's running time that makes it a window of hunting
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
        return self.share >= BLOWS_SHARE


BLOWS_SHARE = 0.5  # of a window's running time that makes it a window of a wheel with a flat
NO_BLOWS = TurnBlows(0.0, 0.0, 0.0, 0)


@dataclass(frozen=True, slots=True)
class WindowQuality:
    """What gates look at before a window is estimated."""

    coverage: float  # share of grid points with a valid sample, 0 to 1
    longest_gap_s: float
    gaps: int
    clipped: float  # share of samples with the clipping bit or a raw value at its limit
    invalid: float  # share of samples marked invalid by the sensor
    speed_min_m_s: float
    speed_max_m_s: float
    position_quality: float  # 0 (unknown) to 1
    sensor_fault: bool  # self-test failed or an emergency was sent
    hunting: Hunting = NOT_HUNTING  # found from all samples, clipped ones too
    blows: TurnBlows = NO_BLOWS  # likewise


@dataclass(frozen=True, slots=True)
class Window:
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
    lateral_acceleration: FloatArray  # (n,) m/s2
    yaw_acceleration: FloatArray  # (n,) rad/s2
    roll_acceleration: FloatArray  # (n,) rad/s2
    mass_lateral_acceleration: FloatArray  # (n,) m/s2
    speed: FloatArray  # (n,) m/s
    distance: FloatArray  # (n,) m along the section
    valid: BoolArray  # (n,)
    resolution: tuple[float, float, float, float]
    track_section: str | None
    odometer_m: float  # vehicle odometer at the start of the window
    quality: WindowQuality
    frame_yaw_acceleration: FloatArray | None = None  # (n,) rad/s2, of the bogie frame; None without a bogie
    measures_gravity: bool = False  # lateral accelerations are specific forces: g times the roll is in them
    backwards: bool = False  # the vehicle runs with its rear end first, and yaw has been turned over
    bridged: BoolArray | None = None  # (n,); None where none are; not stored

    def __post_init__(self) -> None:
        n = len(self.valid)
        for name in (*ACCELERATIONS, "speed", "distance"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        if self.frame_yaw_acceleration is not None:
            frame = frozen_array(self.frame_yaw_acceleration, (n,), name="frame_yaw_acceleration")
            object.__setattr__(self, "frame_yaw_acceleration", frame)
        object.__setattr__(self, "valid", frozen_array(self.valid, (n,), np.bool_, name="valid"))
        if self.bridged is not None:
            object.__setattr__(self, "bridged", frozen_array(self.bridged, (n,), np.bool_, name="bridged"))


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

    SUMS = "sums"


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


WindowKey = tuple[str, int]
"""Wheelset and start of a window, in vehicle time."""


def text_of_key(wheelset: str, start_ns: int) -> str:
    """Return the key of a window as text."""
    return f"{wheelset}@{start_ns}"


def key_of_text(text: str) -> WindowKey:
    """Return wheelset and start of a window from its key as text."""
    wheelset, _, start = text.rpartition("@")
    return wheelset, int(start)


@dataclass(frozen=True, slots=True)
class WindowRecord:
    """A stored window without its samples. Key: (wheelset, start_ns)."""

    wheelset: str
    start_ns: int
    length_ns: int
    vehicle: str
    axle: int
    track_section: str | None
    mileage_km: float  # of the wheelset since new, at the start
    quality: WindowQuality
    state: WindowState
    reason: Reason | None
    content_digest: str  # sha256 of the samples; the same content again changes nothing
    recorded_ns: int
    implausible: Reason | None = None  # why its mileage is not believed
    samples_purged: bool = False

    @property
    def key(self) -> WindowKey:
        """Wheelset and start."""
        return self.wheelset, self.start_ns


@dataclass(frozen=True, slots=True)
class WindowMark:
    """A window and the state that it is to have."""

    wheelset: str
    start_ns: int
    state: WindowState
    reason: Reason | None = None  # of a refusal

    @property
    def key(self) -> WindowKey:
        """Wheelset and start."""
        return self.wheelset, self.start_ns


@dataclass(frozen=True, slots=True)
class MileageReading:
    """The mileage of a wheelset at the start of a window, and what speaks against it by itself.

    Attributes:
        start_ns: Vehicle time.
        mileage_km: Of the wheelset since new.
        odometer_excess_m: By how much the change of the odometer within the window differs from the integral of the
            speed beyond what is allowed, m; 0 where it does not.
        off_line_m: How far the vehicle was from the line of the section that it reported, by GNSS, m; 0 within the
            limit.
    """

    start_ns: int
    mileage_km: float
    odometer_excess_m: float = 0.0
    off_line_m: float = 0.0
