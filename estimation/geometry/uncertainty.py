"""What is not known of the vehicle, of the track and of the lateral displacement, as standard deviations of a geometry.

A measured displacement has an error (std e). A large measured displacement is too large on average, by the factor
1/(1 - e^2/var), which flattens the curve; and kinks are rounded over e.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from estimation.geometry.parameters import PRIORS
from estimation.geometry.sharpening import FREE, ContactRoll, held_shares
from estimation.values.arrays import BoolArray, FloatArray
from estimation.values.track import AlignmentSource, TrackAlignment, TrackFindings, open_gauge_std
from estimation.vehicle.vehicle_class import VehicleClass

MOUNTING_STD = PRIORS.mounting_std
SCALE_STDS = {ContactRoll.SEEN: PRIORS.scale_std_seen, ContactRoll.HIDDEN: PRIORS.scale_std_hidden}


def quotient_widening(relative: float) -> float:
    """Return by how much the std of a quotient exceeds that of first order: 1/(1 - s), infinite from 0.4."""
    # The quotient grows without limit as its divisor, of relative std s, nears zero. With this std 92 to 96 % of the 95
    # % intervals of 1/(1 + e), e normal with std s, hold 1.
    return 1.0 / (1.0 - relative) if relative < PRIORS.unknown_factor_std else float("inf")


@dataclass(frozen=True, slots=True)
class ParameterUncertainty:
    """Relative standard deviation of the assumed parameters of the vehicle; zero for a simulation's own truth.

    The defaults read +-20 % of the creep coefficients, +-10 % of the springs and +-5 % of the masses as 95 % limits.
    ``ratio``, where it has been estimated, is that of yaw stiffness over longitudinal creep coefficient; it then
    replaces both in the yaw equation.
    """

    creep: float = 0.10
    stiffness: float = 0.05
    mass: float = 0.025
    ratio: float | None = None
    # mean and std of 1/mu, by which creep falls short of the linear law: rails have a mu of 0.15 to 0.6
    inverse_friction: tuple[float, float] = (3.3, 1.2)
    displacement: float = 0.0  # of a common scale error of y - d: lateral sensor and alignment
    jump_position_std: float = 0.0  # m, of where contact jumps are from place to place, on a gauge that varies
    jump_mean_std: float = 0.0  # m, of where they are on average: a gauge that is not on file
    alignment_noise: float = 0.0  # m, std of the error of y - d by the alignment; that by sensors is in bin tables
    scale: float = 0.0  # of rL - rR as a whole: by nominal radius, half contact distance and the yaw sensor
    of_bogie: tuple[float, float, float] = (0.02, 0.02, MOUNTING_STD)  # yaw sensor against the frame's, those, angle
    held_shares: tuple[float, ...] = FREE  # of a difference of diameters, by ``sharpening.SLOPES``
    contact_roll: ContactRoll | None = None  # in y - d; None where y - d needs nothing more
    usual_cutoff: float = 40.0  # m, of the high-pass of the motion
    jump_share_uncorrected: float = 0.5  # of the gauge's own std: contact jumps move by half the gauge deviation
    jump_share_corrected: float = 0.22  # the same where the effect of the gauge is taken off
    jump_share_gauge_estimated: float = 0.32  # the same where the gauge had to be found too
    jump_mean_share: float = 0.45  # of a gauge that hides in the alignment: by how much jumps are off on average
    scale_per_gauge_square: float = 0.015e6  # 1/m2, of y - d per variance of the gauge: far out it is wide
    scale_per_mean_gauge: float = 0.15e3  # 1/m, of y - d per gauge that is wide as a whole: worn wheels at 3 mm
    sensor_scale: float = 0.02  # std of the spring error by the scales of the sensors
    sensors_in_bogie: float = 0.06  # the same: scales, angles, clocks of three sensors, and creep near saturation
    share_in_bogie: float = 0.5  # of an error of stiffness or creep, as spring error; the curve takes up the rest
    seen_in_bogie: float = 0.4  # of an error of the conicity by a wrong class: the curve takes up more
    unseen_share: float = 0.06  # of noise over the power of a yaw that no curve explains: std of the spring error
    doubted_stds: float = 1.8  # of the spring error, a doubtful class: right ones have 0.5 rms, at most 1.6
    certain_stds: float = 2.2  # beyond which it is another: four times the rms of right ones
    doubted_misfit: float = 0.55  # right classes on measured wheels and on gauge that varies unknown have up to 0.51
    certain_misfit: float = 0.65
    misfit_share: float = 0.5  # of the square of the misfit: by how much it may spoil the conicity
    noise_doubt: float = 0.5  # of the variance that sensor noise makes: sensors may be as much worse than on file
    least_samples: float = 200.0  # of a bin
    fewest_bins: int = 5
    free_std: float = 1e6  # std of what nothing is known of beforehand
    straight_std: float = 1e-8  # rad, std of the angle for the spring error: it is that of sensors that are not turned
    long_waves: int = 16  # parts of a section whose mean gauge shows waves that are longer than they are
    jump_share_long: float = 0.75  # of the std of the mean of a known gauge: by how much jumps are off on average
    gauge_known: bool = False  # of all tracks

    @classmethod
    def of(cls, vehicle_class: VehicleClass) -> Self:
        """Return what is not known of the vehicles of a class."""
        roll = ContactRoll.HIDDEN if vehicle_class.sensors.measures_gravity else ContactRoll.SEEN
        return cls(
            creep=vehicle_class.std_of("longitudinal_creep_coefficient"),
            stiffness=vehicle_class.std_of("yaw_stiffness"),
            mass=vehicle_class.std_of("yaw_inertia"),
            displacement=math.hypot(vehicle_class.sensors.lateral.scale_std, SCALE_STDS[roll]),
            scale=math.hypot(
                vehicle_class.std_of("nominal_radius"),
                vehicle_class.std_of("half_contact_distance"),
                vehicle_class.sensors.yaw.scale_std,
            ),
            of_bogie=_sensors_of_bogie(vehicle_class),
            held_shares=held_shares(vehicle_class),
            contact_roll=roll,
        )

    def on(self, tracks: Iterable[TrackAlignment], wheelset: str | None = None) -> ParameterUncertainty:
        """Return what these alignments leave unknown of a geometry; without a wheelset their findings count for any."""
        used = list(tracks)
        findings = [_findings_for(track, wheelset) for track in used]
        ratio_stds = [item.stiffness_ratio_std for item in findings if item is not None]
        return replace(
            self,
            ratio=max(ratio_stds) if ratio_stds and len(ratio_stds) == len(used) else self.ratio,
            alignment_noise=max((alignment_std(one, self) for one in used), default=self.alignment_noise),
            displacement=math.hypot(
                self.displacement, max((_scale_std(one, wheelset, self) for one in used), default=0.0)
            ),
            jump_position_std=max(
                (_jump_position_std(track, wheelset, self) for track in used), default=self.jump_position_std
            ),
            jump_mean_std=max((_jump_mean_std(track, self) for track in used), default=self.jump_mean_std),
            gauge_known=bool(used) and all(track.gauge_known for track in used),
        )

    def lateral(self) -> FloatArray:
        """(6,) relative stds in the order of LATERAL_TARGETS after z1."""
        return np.array([self.creep, self.creep, self.mass, self.mass, self.stiffness, self.stiffness])

    def yaw(self, *, linear: bool = True) -> FloatArray:
        """(7,) relative stds in the order of YAW_TARGETS after z2; that of saturation is of 1/mu.

        Args:
            linear: Whether creep forces are taken as linear, so that all of 1/mu is error.
        """
        creep, stiffness = (self.creep, self.stiffness) if self.ratio is None else (0.0, self.ratio)
        friction = math.hypot(*self.inverse_friction) if linear else self.inverse_friction[1]
        return np.array([creep, stiffness, self.mass, self.creep, friction, 0.0, 0.0])


def _sensors_of_bogie(vehicle_class: VehicleClass) -> tuple[float, float, float]:
    """Return the stds of the yaw sensor's scale against the frame's, of the frame sensors' difference, of the angle."""
    of_yaw, of_frame = vehicle_class.sensors.yaw.scale_std, vehicle_class.sensors.mass_lateral.scale_std
    least = PRIORS.least_scale_std
    return math.hypot(least, of_yaw, of_frame), math.hypot(least, math.sqrt(2.0) * of_frame), MOUNTING_STD


def _findings_for(track: TrackAlignment, wheelset: str | None) -> TrackFindings | None:
    """Return what has been found on ``track``; windows on a recording do not wait for findings of their wheelset."""
    # where no gauge moves wheelsets, what has been found is of vehicles alone
    if track.findings is None or wheelset is None or track.source != AlignmentSource.RECORDED:
        return track.findings
    if not track.findings.gauge_shifts:
        return track.findings
    return track.findings if wheelset in track.findings.gauge_shifts else None


def alignment_std(track: TrackAlignment, uncertainty: ParameterUncertainty) -> float:
    """Return the median std, m, of an alignment where it is known, at the usual cut-off of the motion."""
    # that of a fleet is of all waves up to its own cut-off, and nearly all of it of the longest, for accelerations are
    # integrated twice: its variance grows as the cube of the cut-off
    known = np.isfinite(track.alignment_std)
    std = float(np.median(track.alignment_std[known])) if known.any() else 0.0
    share = uncertainty.usual_cutoff / track.cutoff_wavelength if track.source == AlignmentSource.FLEET else 1.0
    return float(std * min(share, 1.0) ** 1.5)


def _scale_std(track: TrackAlignment, wheelset: str | None, uncertainty: ParameterUncertainty) -> float:
    """Return the relative std of y - d on ``track``: what its alignment leaves open, and what its gauge does."""
    # A surveyed gauge that is wide as a whole changes the conicity as a whole. What is found of a wheelset on a gauge
    # that varies covers that only as far as it varies.
    mean, std = abs(float(np.mean(track.gauge_deviation))), float(np.std(track.gauge_deviation))
    beyond = max(mean - std, 0.0) if _gauge_taken_off(track, wheelset) else mean
    of_gauge = (uncertainty.scale_per_gauge_square * std**2, uncertainty.scale_per_mean_gauge * beyond)
    return float(np.linalg.norm([track.scale_std, *of_gauge]))


def _gauge_taken_off(track: TrackAlignment, wheelset: str | None) -> bool:
    shifts = {} if track.findings is None else track.findings.gauge_shifts
    return bool(shifts) if wheelset is None else wheelset in shifts


def _jump_position_std(track: TrackAlignment, wheelset: str | None, uncertainty: ParameterUncertainty) -> float:
    taken_off = uncertainty.jump_share_corrected if track.gauge_known else uncertainty.jump_share_gauge_estimated
    share = taken_off if _gauge_taken_off(track, wheelset) else uncertainty.jump_share_uncorrected
    spread = float(np.std(track.gauge_deviation))
    return share * (spread if track.gauge_known else max(spread, float(np.median(track.gauge_deviation_std))))


def _jump_mean_std(track: TrackAlignment, uncertainty: ParameterUncertainty) -> float:
    # A gauge of waves so long that the filters take them moves all jumps together, and blurs none. Where it is known, a
    # section has few such waves, and what they do on average is no more than by the mean of few.
    if track.gauge_known:
        parts = min(uncertainty.long_waves, len(track.gauge_deviation))
        means = [float(part.mean()) for part in np.array_split(track.gauge_deviation, parts)]
        return uncertainty.jump_share_long * float(np.std(means)) / math.sqrt(parts)
    return uncertainty.jump_mean_share * open_gauge_std(track.scale_std, float(np.median(track.gauge_deviation_std)))


@dataclass(frozen=True, slots=True)
class DisplacementError:
    """Std of the error of y - d, by how much the measured displacement is too large, and what is off as a whole."""

    std: float  # m
    excess: float  # share
    scale: float  # share, std
    origin: float = 0.0  # m, std
    jump_position_std: float = 0.0  # m, std of where contact jumps are besides, from place to place
    jump_mean_std: float = 0.0  # m, the same on average
    gauge_known: bool = False  # so that jumps are blurred by as much as is stated

    @property
    def blur(self) -> float:
        """The std, m, over which the error and a varying gauge blur contact jumps."""
        return float(np.hypot(self.std, self.jump_position_std))

    def jump_place_std(self, excess: float, left: float) -> float:
        """Return the std, m, of where contact jumps are found on average.

        Args:
            excess: Blur, m std, that has been taken away beyond what the error of y - d makes.
            left: Blur, m std, that could not be taken away.
        """
        of_blur = PRIORS.jump_place_per_excess * excess, PRIORS.jump_place_per_left * left
        return float(np.linalg.norm([PRIORS.jump_place_std, *of_blur, self.jump_mean_std]))

    @staticmethod
    def of(
        std: float,
        centre: FloatArray,
        samples: FloatArray,
        *,
        integrated: bool,
        scale: float = 0.0,
        gauge_known: bool = False,
        **jumps: float,
    ) -> DisplacementError:
        """Return the error for displacements distributed as ``samples`` (b,) over bins at ``centre`` (b,), m.

        ``scale`` is the relative std of a common scale error of y - d besides that of the integration; ``jumps`` are
        the fields of where contact jumps are.
        """
        variance = float(np.average(centre**2, weights=samples)) if samples.any() else 0.0
        excess = min(std**2 / variance, PRIORS.most_error_share) if variance > 0 else 0.0
        known = (0.0, 0.0) if not integrated else (PRIORS.projection_scale_std, PRIORS.origin_std)
        stretch = float(np.hypot(known[0], scale))
        return DisplacementError(std, excess, stretch, known[1], gauge_known=gauge_known, **jumps)

    def rounded(self, x: FloatArray, values: FloatArray) -> FloatArray:
        """Return the curve averaged over a normal error of x (three-point Gauss-Hermite); straight beyond its ends."""
        step = np.sqrt(3.0) * self.std
        line_low = (values[1] - values[0]) / (x[1] - x[0])
        line_high = (values[-1] - values[-2]) / (x[-1] - x[-2])
        before = np.interp(x - step, x, values) + line_low * np.minimum(x - step - x[0], 0.0)
        after = np.interp(x + step, x, values) + line_high * np.maximum(x + step - x[-1], 0.0)
        return np.asarray(before / 6 + 2 * values / 3 + after / 6)

    def std_of_bins(self, centre: FloatArray, values: FloatArray, smooth: BoolArray, observed: BoolArray) -> FloatArray:
        """Return what the error leaves unknown of a value per bin (b,): scale, origin, rounding.

        Args:
            smooth: (b,) bins with a value of the curve; elsewhere the result is zero.
            observed: (b,) bins with any value, those included that a contact jump crosses: no part of the curve's
                slope, but samples scatter from them into their neighbours.
        """
        left_unknown = np.zeros(len(centre))
        if smooth.sum() < 2:  # noqa: PLR2004 - no slope of one value
            return left_unknown
        x = centre[smooth]
        slope = np.gradient(values[smooth], x)
        above_centre = values[smooth] - np.interp(
            0.0, x, values[smooth]
        )  # jumps below are part of it, not of the slope
        scaled = np.maximum(np.abs(slope * x), np.abs(above_centre)) * np.hypot(self.excess, self.scale)
        shifted = np.hypot(scaled, slope * np.hypot(self.origin, PRIORS.origin_std_share * self.jump_position_std))
        scattered = np.zeros(len(centre))
        both = replace(self, std=float(np.hypot(PRIORS.scatter_stds * self.std, self.jump_position_std)))
        scattered[observed] = both.rounded(centre[observed], values[observed]) - values[observed]
        left_unknown[smooth] = np.hypot(shifted, scattered[smooth])
        return left_unknown
