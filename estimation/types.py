"""The values that flow: frames, samples, windows, bin tables, geometries, trends.

All are frozen and slotted; arrays are float64 unless said, read-only, and checked at construction. SI inside:
metres, radians, seconds, newtons. Times are int64 nanoseconds UTC (Unix epoch); ``t_ns`` and ``start_ns`` are on the
vehicle's clock, ``received_ns`` on ours, ``recorded_ns`` in commit order. Axes: x forward, y left, z up (ISO 8855).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from estimation.arrays import BoolArray, FloatArray, IntArray, frozen_array

RECORDED = "recorded"
FLEET = "fleet"
EXTENDED_FLAG = 0x8000_0000
REMOTE_FLAG = 0x4000_0000
ERROR_FLAG = 0x2000_0000


class Status(StrEnum):
    """What a published number is worth."""

    UNESTIMATED = "unestimated"
    ESTIMATED = "estimated"
    INVALID = "invalid"


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number with its uncertainty; never published without.

    ``value`` and ``std`` are None exactly when ``status`` is not ``estimated``; then ``reason`` says why.
    ``low`` and ``high`` are the ends of the 95 % interval, ``count`` the effective number of windows behind it.
    """

    value: float | None
    std: float | None
    low: float | None
    high: float | None
    count: float
    status: Status
    reason: str = ""

    @staticmethod
    def unknown(reason: str, count: float = 0.0, status: Status = Status.UNESTIMATED) -> Estimate:
        """Return the estimate that says: not known, for this reason."""
        return Estimate(None, None, None, None, count, status, reason)


@dataclass(frozen=True, slots=True)
class FrameBatch:
    """Frames of one bus, in the order they were recorded.

    ``arbitration_id`` carries SocketCAN's flags in its upper bits (EXTENDED_FLAG, REMOTE_FLAG, ERROR_FLAG).
    Bytes of ``data`` beyond ``dlc`` are zero.
    """

    channel: str
    t_ns: IntArray  # (n,)
    arbitration_id: npt.NDArray[np.uint32]  # (n,)
    dlc: npt.NDArray[np.uint8]  # (n,)
    data: npt.NDArray[np.uint8]  # (n, 8)

    def __post_init__(self) -> None:
        n = len(self.t_ns)
        object.__setattr__(self, "t_ns", frozen_array(self.t_ns, (n,), np.int64, name="t_ns"))
        object.__setattr__(
            self, "arbitration_id", frozen_array(self.arbitration_id, (n,), np.uint32, name="arbitration_id")
        )
        object.__setattr__(self, "dlc", frozen_array(self.dlc, (n,), np.uint8, name="dlc"))
        object.__setattr__(self, "data", frozen_array(self.data, (n, 8), np.uint8, name="data"))

    def __len__(self) -> int:
        return len(self.t_ns)


@dataclass(frozen=True, slots=True)
class SampleBlock:
    """Samples of one node of one vehicle on one time base; where ``valid`` is False the value is NaN."""

    vehicle: str
    node: int
    signals: tuple[str, ...]  # m names
    t_ns: IntArray  # (n,), strictly increasing
    values: FloatArray  # (n, m)
    valid: BoolArray  # (n, m)

    def __post_init__(self) -> None:
        n, m = len(self.t_ns), len(self.signals)
        object.__setattr__(self, "t_ns", frozen_array(self.t_ns, (n,), np.int64, name="t_ns"))
        object.__setattr__(self, "values", frozen_array(self.values, (n, m), name="values"))
        object.__setattr__(self, "valid", frozen_array(self.valid, (n, m), np.bool_, name="valid"))

    def __len__(self) -> int:
        return len(self.t_ns)


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


@dataclass(frozen=True, slots=True)
class Window:
    """A fixed length of running time of one wheelset, on a uniform grid; accelerations are NaN where not ``valid``.

    ``start_ns`` is a multiple of the window length on the vehicle's clock, so that windows do not depend on how
    recordings were cut. ``distance`` is the position of the wheelset (not of the vehicle's antenna) along the track
    section. ``resolution`` holds the SI value of one count of each acceleration, in the order of the fields: the
    accelerations are whole multiples of it.
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

    def __post_init__(self) -> None:
        n = len(self.valid)
        for name in (*ACCELERATIONS, "speed", "distance"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        object.__setattr__(self, "valid", frozen_array(self.valid, (n,), np.bool_, name="valid"))


ACCELERATIONS = ("lateral_acceleration", "yaw_acceleration", "roll_acceleration", "mass_lateral_acceleration")


@dataclass(frozen=True, slots=True)
class GaugeShift:
    """Where a gauge deviation puts a wheelset: y - d at a rolling radius difference and a gauge deviation, m.

    Told as the shift against nominal gauge at the same rolling radius difference: that is measured well, and contact
    jumps, which move over y - d with the gauge, are steps of it. Linear between the grids, flat beyond them.
    """

    difference: FloatArray  # (r,) rL - rR, m, uniform, increasing
    gauge: FloatArray  # (e,) m, uniform, increasing
    shift: FloatArray  # (r, e) m

    def __post_init__(self) -> None:
        for name in ("difference", "gauge"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (len(getattr(self, name)),), name=name))
        shape = (len(self.difference), len(self.gauge))
        object.__setattr__(self, "shift", frozen_array(self.shift, shape, name="shift"))

    def at(self, difference: FloatArray, gauge_deviation: FloatArray) -> FloatArray:
        """Return the shift (n,), m, at rL - rR (n,) and gauge deviation (n,), m."""
        i, u = _cells(difference, self.difference)
        j, v = _cells(gauge_deviation, self.gauge)
        table = self.shift
        low = (1.0 - v) * table[i, j] + v * table[i, j + 1]
        high = (1.0 - v) * table[i + 1, j] + v * table[i + 1, j + 1]
        return np.asarray((1.0 - u) * low + u * high)

    def over(self, difference: FloatArray, gauge_deviation: FloatArray) -> FloatArray:
        """Return the shift (n, g), m, at every rL - rR (n,) for each of some gauge deviations (g,), m."""
        i, u = _cells(difference, self.difference)
        j, v = _cells(gauge_deviation, self.gauge)
        table = (1.0 - v) * self.shift[:, j] + v * self.shift[:, j + 1]
        return np.asarray((1.0 - u)[:, None] * table[i] + u[:, None] * table[i + 1])


def _cells(values: FloatArray, grid: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the cell (n,) of a uniform grid in which each value lies, and where in it, 0 to 1."""
    position = np.clip((values - grid[0]) / (grid[1] - grid[0]), 0.0, len(grid) - 1.0)
    cell = np.minimum(position.astype(np.int64), len(grid) - 2)
    return cell, np.asarray(position - cell)


@dataclass(frozen=True, slots=True)
class Findings:
    """What the passes of a section say besides its alignment, for those who passed it."""

    stiffness_ratio: Mapping[str, float]  # by vehicle: true yaw stiffness over creep coefficient, of the assumed one
    stiffness_ratio_std: float  # largest of them
    gauge_shifts: Mapping[str, GaugeShift]  # by wheelset, where gauge varies


@dataclass(frozen=True, slots=True)
class TrackAlignment:
    """What is known of a track section: lateral alignment and gauge deviation against distance, each with its std."""

    section: str
    version: int
    s: FloatArray  # (n,) m, uniform
    alignment: FloatArray  # (n,) m, positive to the left
    alignment_std: FloatArray  # (n,) m
    gauge_deviation: FloatArray  # (n,) m, actual minus nominal gauge
    gauge_deviation_std: FloatArray  # (n,) m
    passes: IntArray  # (n,) passes behind each value; 0 for a recording car
    status: Status
    source: str = RECORDED  # or FLEET
    cut_off: float = np.inf  # m; longer wavelengths are not in ``alignment``
    scale_std: float = 0.0  # relative, of a common stretch of y - d that the alignment leaves open
    gauge_known: bool = True  # False: from the passes alone, or zero for want of knowledge; see its std
    findings: Findings | None = None  # of a fleet, on its own alignment or on a recording whose gauge varies

    def __post_init__(self) -> None:
        n = len(self.s)
        for name in ("s", "alignment", "alignment_std", "gauge_deviation", "gauge_deviation_std"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        object.__setattr__(self, "passes", frozen_array(self.passes, (n,), np.int64, name="passes"))


@dataclass(frozen=True, slots=True)
class TrackLayout:
    """The horizontal layout of a track section as built, from the infrastructure register; straight between points."""

    section: str
    version: int
    s: FloatArray  # (n,) m along the section, strictly increasing
    curvature: FloatArray  # (n,) 1/m, positive in a curve to the left
    cant: FloatArray  # (n,) m, right rail above the left one: positive where it leans into a curve to the left

    def __post_init__(self) -> None:
        n = len(self.s)
        for name in ("s", "curvature", "cant"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        if n < 2 or not (np.diff(self.s) > 0).all():  # noqa: PLR2004 - a stretch has two ends
            raise ValueError("s: two points or more, strictly increasing, are needed")


@dataclass(frozen=True, slots=True)
class BinTable:
    """Mergeable sufficient statistics of the piecewise least squares, per bin of lateral displacement and group.

    Groups are what standard deviations come from: blocks of running time are dealt to ``g`` groups, and any derived
    number is recomputed with one group left out (delete-a-group jackknife). ``lateral`` and ``yaw`` hold, per group and
    bin, the packed moments that ``estimation.least_squares`` lays out.
    """

    parameter_key: str  # digest of every parameter that shapes the statistics
    edges: FloatArray  # (b + 1,) m
    weight: FloatArray  # (g, b) sum of weights; the sample count without forgetting
    lateral: FloatArray  # (g, b, q) regressors [x1, x1 u, x2, x2 u], targets z1 and its parameter sensitivities
    yaw: FloatArray  # (g, b, r) regressors [(l W/2) psi, c, c u, c u^2], targets z2 and its sensitivities
    samples: int  # samples ever added, without weights
    windows: int

    def __post_init__(self) -> None:
        b = len(self.edges) - 1
        g = len(self.weight)
        object.__setattr__(self, "edges", frozen_array(self.edges, (b + 1,), name="edges"))
        object.__setattr__(self, "weight", frozen_array(self.weight, (g, b), name="weight"))
        object.__setattr__(self, "lateral", frozen_array(self.lateral, (g, b, None), name="lateral"))
        object.__setattr__(self, "yaw", frozen_array(self.yaw, (g, b, None), name="yaw"))


class BinStatus(StrEnum):
    """Why a bin's number is published or not."""

    ESTIMATED = "estimated"
    TOO_FEW = "too few samples"
    CONTACT_JUMP = "a contact jump crosses the bin"
    UNOBSERVABLE = "the data cannot say"


COMBINATIONS = (
    "rolling_radius_sum",
    "rolling_radius_difference",
    "contact_angle_sum",
    "contact_angle_difference",
)


@dataclass(frozen=True, slots=True)
class BinValues:
    """One of the four combinations over the bins; NaN where not estimated."""

    value: FloatArray  # (b,) m or rad
    std: FloatArray  # (b,)
    status: tuple[BinStatus, ...]  # (b,)

    def __post_init__(self) -> None:
        b = len(self.status)
        object.__setattr__(self, "value", frozen_array(self.value, (b,), name="value"))
        object.__setattr__(self, "std", frozen_array(self.std, (b,), name="std"))


@dataclass(frozen=True, slots=True)
class WheelsetGeometry:
    """What the data say of one wheelset's contact geometry."""

    bin_edges: FloatArray  # (b + 1,) m, lateral displacement y - d
    samples: FloatArray  # (b,) effective samples
    rolling_radius_sum: BinValues
    rolling_radius_difference: BinValues
    contact_angle_sum: BinValues
    contact_angle_difference: BinValues
    amplitude: FloatArray  # (k,) m
    conicity: tuple[Estimate, ...]  # (k,) equivalent conicity at each amplitude
    headline_amplitude: float  # m: 3 mm, or the largest amplitude covered
    equivalent_conicity: Estimate  # at headline_amplitude
    nonlinearity: Estimate  # NP, 1/mm as in EN 15302: (tan gamma_e(4 mm) - tan gamma_e(2 mm)) / 2
    zero_crossing: Estimate  # m, lateral displacement where rL = rR
    windows: int
    parameter_key: str
    status: Status
    reason: str = ""

    def __post_init__(self) -> None:
        b = len(self.samples)
        object.__setattr__(self, "bin_edges", frozen_array(self.bin_edges, (b + 1,), name="bin_edges"))
        object.__setattr__(self, "samples", frozen_array(self.samples, (b,), name="samples"))
        object.__setattr__(self, "amplitude", frozen_array(self.amplitude, (len(self.conicity),), name="amplitude"))


@dataclass(frozen=True, slots=True)
class Forecast:
    """Where a limit is reached: quantiles over the trend's uncertainty; None means not within the horizon."""

    p10: float | None
    p50: float | None
    p90: float | None


@dataclass(frozen=True, slots=True)
class WearTrend:
    """An indicator since the last reprofiling, its robust slope, and when it reaches its limit."""

    quantity: str  # "equivalent_conicity"
    mileage_km: FloatArray  # (k,) since the wheelset was new
    measured_ns: IntArray  # (k,)
    value: FloatArray  # (k,)
    std: FloatArray  # (k,)
    slope_per_1000_km: Estimate
    slope_per_year: Estimate
    current: Estimate  # fitted value at the last point
    limit: float
    distance_to_limit_km: Forecast  # from the last point; 0 where already reached
    date_of_limit_ns: Forecast
    probability_over_limit: float | None  # now
    status: Status
    reason: str = ""

    def __post_init__(self) -> None:
        k = len(self.value)
        for name in ("mileage_km", "value", "std"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (k,), name=name))
        object.__setattr__(self, "measured_ns", frozen_array(self.measured_ns, (k,), np.int64, name="measured_ns"))
