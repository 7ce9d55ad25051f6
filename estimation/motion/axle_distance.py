"""How far the two axles of a bogie are apart, from what their nodes measure: the roll of both on one track.

Over short waves a wheelset does not follow the track, whatever its suspension and its wear: its roll is the track's,
and that of the rear axle is the same, later by the wheelbase. Where the nodes say otherwise, they are not on the axles
that they are registered on, or the bogie is another one.

Which end of a vehicle goes first, by what its nodes measure: trains run either way without being turned.

An axle that rolls forward with a yaw to the left moves to the left, y' = V psi; with its rear end first a vehicle moves
to the right. Looked at in a mirror across the track it runs forward: its yaw has the other sign, left remains left,
and what is in front is behind. So a window of such a journey is turned over once, when it is loaded, and ordinary then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from estimation.motion.checks import direction, runs_backwards
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.windows import Window


@dataclass(frozen=True, slots=True)
class AxleDistanceParameters:
    """When signals of two axles show the order and the distance of these."""

    grid_step: float = 0.1  # m
    wavelength_band: tuple[float, float] = (3.0, 6.0)  # m, wavelengths: the ends of a band-pass of 4th order
    filter_order: int = 4
    farthest_shift: float = 5.0  # m; beyond, the next wave of the band looks alike
    filtered_end: float = 30.0  # m that the filter takes at each end
    least_distance: float = 300.0  # m
    least_valid_share: float = 0.5  # of the samples of a window that both nodes must have
    significant_stds: float = 5.0  # times the std of the correlation of two nodes that have nothing in common
    least_correlation: float = 0.65  # wheelsets on their own waves, not the track's, agree by up to 0.64 further on
    least_exchanged: float = 0.5  # the same at one distance that is known beforehand: that of nodes that are exchanged
    distance_tolerance: float = 0.4  # m; what is found is within 0.25 m of the truth
    next_wave_distance: float = 1.0  # m: further away the maximum may be that of another wave
    stand_out_ratio: float = 1.03  # times the next maximum: a wheelset's own waves are alike, on rough track 0.87
    clear_ratio: float = 1.9  # times what the distance found leaves open, that the expected one leaves: right ones 1.8
    exchanged_ratio: float = 1.25  # the same where the other distance is that of exchanged nodes; right ones below 1
    least_frame_share: float = 0.2  # of what the frame moves above the other axle: right nodes have a half and more


AXLES = AxleDistanceParameters()


@dataclass(frozen=True, slots=True)
class AxleDistance:
    """By how far an axle is ahead of the other one of its bogie.

    A wheelset that is mounted the other way round rolls the other way, so that both signs count. Waves of a wheelset's
    own make distances alike that are half a wave apart, with signs that alternate.
    """

    ahead: float  # m, negative where it is behind
    correlation: float  # of the rolls there, its magnitude
    expected: float  # the highest magnitude within ``AXLES.distance_tolerance`` of the expected distance
    exchanged: float  # the same of the expected distance with the other sign
    nearest: float = np.inf  # m from the expected distance to the nearest maximum that is no chance
    stands_out: bool = False  # whether that one is the highest, and not by chance: those a wave away are lower
    ordered: bool | None = None  # whether such a one is where it is expected (True) or where exchanged nodes have it

    @property
    def leads(self) -> bool | None:
        """Whether the axle meets the track in the order of the registry; None where the rolls do not say."""
        if max(self.expected, self.exchanged) < AXLES.least_exchanged:
            return self.ordered
        clearer = _clearer(self.exchanged, self.expected)
        return False if clearer >= AXLES.exchanged_ratio else True if 1.0 / clearer >= AXLES.exchanged_ratio else None

    @property
    def contradicted(self) -> bool:
        """Whether the rolls say that the distance is another one."""
        if self.leads is False:
            return True
        if self.nearest <= AXLES.distance_tolerance:
            return False
        if self.nearest <= AXLES.next_wave_distance and self.stands_out:
            return True
        agrees = self.correlation >= AXLES.least_correlation
        return agrees and _clearer(self.correlation, self.expected) >= AXLES.clear_ratio


def _clearer(correlation: float, other: float) -> float:
    return (1.0 - other**2) / max(1.0 - correlation**2, np.finfo(np.float64).eps)


def check_axle_distance(window: Window, partner: Window, ahead: float) -> Reason | None:
    """Return that the nodes of a bogie contradict where they are registered; None where they do not or are silent.

    Args:
        window, partner: Of the two nodes of a bogie, over the same time, with as many samples.
        ahead: By how much the node of ``window`` is ahead of the other in the direction of travel, m, by the registry;
            negative at the axle behind.
    """
    distance = axle_distance(window, partner, ahead)
    if distance is None or not distance.contradicted:
        return None
    at = -ahead if distance.leads is False else distance.ahead
    correlation = distance.exchanged if distance.leads is False else distance.correlation
    return Reason(
        ReasonCode.AXLE_DISTANCE,
        f"the track reaches the other axle of the bogie {at:+.1f} m later, by the registry {ahead:+.1f} m"
        f" (correlation {correlation:.2f})",
    )


def axle_distance(window: Window, partner: Window, ahead: float) -> AxleDistance | None:
    """Return by how far one axle of a bogie is ahead of the other; None where too little is known."""
    known = window.valid & partner.valid & np.isfinite(window.speed)
    if known.mean() < AXLES.least_valid_share:
        return None
    at = np.arange(len(known))
    speed = np.interp(at, at[known], window.speed[known])
    run = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]))]) * window.sample_interval_s
    if run[-1] < AXLES.least_distance:
        return None
    own, other = (_short_waves(run, node.roll_acceleration, known) for node in (window, partner))
    power = float(np.sqrt((own @ own) * (other @ other)))
    if not power > 0.0:
        return None
    shortest, longest = AXLES.wavelength_band
    # std of the correlation of two signals of the band, as long, that have nothing in common
    by_chance = 1.0 / math.sqrt(2.0 * (AXLES.grid_step * len(own)) * (1.0 / shortest - 1.0 / longest))
    return _highest(_correlation(own, other) / power, ahead, AXLES.significant_stds * by_chance)


def _short_waves(run: FloatArray, roll: FloatArray, known: BoolArray) -> FloatArray:
    """Return a signal every ``AXLES.grid_step``, zero where it is unknown, of the wavelengths of the band."""
    # it is filtered on a grid as fine as its samples: noise of high frequencies would fold into the band, and that of a
    # gyroscope, differentiated, grows with frequency
    from scipy.signal import sosfiltfilt  # noqa: PLC0415 - slow to import, and only windows in bogies need it

    finer = math.ceil(AXLES.grid_step * (len(run) - 1) / run[-1])
    grid = np.arange(0.0, run[-1], AXLES.grid_step / finer)
    values = np.interp(grid, run, np.where(known, roll, 0.0))
    ends = finer * round(AXLES.filtered_end / AXLES.grid_step)
    return np.asarray(sosfiltfilt(_band_pass(finer), values)[ends:-ends:finer])


@lru_cache(maxsize=16)
def _band_pass(finer: int) -> FloatArray:
    from scipy.signal import butter  # noqa: PLC0415 - the same

    shortest, longest = AXLES.wavelength_band
    ends = (1.0 / longest, 1.0 / shortest)
    return np.asarray(butter(AXLES.filter_order, ends, btype="bandpass", fs=finer / AXLES.grid_step, output="sos"))


def _correlation(own: FloatArray, other: FloatArray) -> FloatArray:
    reach = round(AXLES.farthest_shift / AXLES.grid_step)
    size = 1 << (len(own) + reach).bit_length()
    products = np.fft.irfft(np.conj(np.fft.rfft(own, size)) * np.fft.rfft(other, size), size)
    return np.concatenate([products[-reach:], products[: reach + 1]])


def _highest(correlation: FloatArray, ahead: float, least: float) -> AxleDistance:
    """Return the maximum of the magnitude of a correlation beside those at the expected distance, of either sign."""
    # maxima below `least` may be chance
    size = np.abs(correlation)
    distance = AXLES.grid_step * (np.arange(len(size)) - len(size) // 2)
    at = int(np.argmax(size))
    near = [np.abs(distance - expected) <= AXLES.distance_tolerance for expected in (ahead, -ahead)]
    expected, exchanged = (float(size[part].max()) if part.any() else 0.0 for part in near)
    inner = size[1:-1]
    maxima = np.flatnonzero((inner >= size[:-2]) & (inner >= size[2:])) + 1
    clear = maxima[size[maxima] >= min(least, AXLES.least_correlation)]
    nearest = float(np.abs(distance[clear] - ahead).min()) if len(clear) else np.inf
    others = size[maxima[np.abs(distance[maxima] - distance[at]) > AXLES.distance_tolerance]]
    alone = bool(len(clear) and size[at] >= AXLES.stand_out_ratio * max(others, default=0.0))
    off, exchanged_off = abs(distance[at] - ahead), abs(distance[at] + ahead)
    ordered = bool(off < exchanged_off) if alone and min(off, exchanged_off) <= AXLES.distance_tolerance else None
    stands_out = alone and off <= nearest
    return AxleDistance(float(distance[at]), float(size[at]), expected, exchanged, nearest, stands_out, ordered)


def bogie_runs_backwards(window: Window, partner: Window, ahead: float) -> bool | None:
    """Return whether a bogie runs with its rear axle first; None where its nodes do not say."""
    # where they say both, one of them is the wrong way round, and which axle meets the track first decides
    said = {runs_backwards(window), runs_backwards(partner)} - {None}
    if len(said) <= 1:
        return next(iter(said), None)
    rolls = axle_distance(window, partner, ahead)
    return None if rolls is None or rolls.leads is None else not rolls.leads


def turned_over(window: Window, behind: float = 0.0) -> Window:
    """Return the window of a vehicle that runs with its rear end first as one of a vehicle that runs forward.

    Args:
        behind: m, by which its axle is behind the reference of the vehicle's position by the registry. It is ahead of
            it now.
    """
    frame = window.frame_yaw_acceleration
    return replace(
        window,
        yaw_acceleration=-window.yaw_acceleration,
        frame_yaw_acceleration=None if frame is None else -frame,
        distance=window.distance + 2.0 * behind * (direction(window) or 1),
        backwards=not window.backwards,
    )


def check_frame_sensors(window: Window, partner: Window) -> Reason | None:
    """Return that one of the two frame sensors of a bogie measures nothing; None where both do."""
    # A frame moves above both its axles. A sensor that is dead gives one value, or its noise.
    known = window.valid & partner.valid
    if not known.any():
        return None
    nodes = (window, partner)
    moved = [float(np.std(node.mass_lateral_acceleration[known])) for node in nodes]
    least, most = sorted(range(len(nodes)), key=moved.__getitem__)
    if moved[least] >= AXLES.least_frame_share * moved[most] > 0.0:
        return None
    return Reason(
        ReasonCode.FRAME_UNKNOWN,
        f"the frame sensor above axle {nodes[least].axle} measures {moved[least]:.3f} m/s2 rms, the one above axle"
        f" {nodes[most].axle} {moved[most]:.3f}; check the sensor of axle {nodes[least].axle}",
    )


def with_frame_yaw(window: Window, partner: Window, ahead: float) -> Window:
    """Return ``window`` with the yaw acceleration of the frame, valid where both nodes are."""
    # gravity is in both sensors alike, for a frame rolls as one piece, and drops out
    if partner.start_ns != window.start_ns or len(partner.valid) != len(window.valid):
        raise ValueError(f"windows from {window.start_ns} and {partner.start_ns} are not of one time")
    valid = window.valid & partner.valid
    difference = window.mass_lateral_acceleration - partner.mass_lateral_acceleration
    return replace(window, valid=valid, frame_yaw_acceleration=np.where(valid, difference / ahead, np.nan))
