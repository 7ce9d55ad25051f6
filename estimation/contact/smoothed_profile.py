"""Profiles from measured points: a smooth curve along the arc, and how well it is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from estimation.contact.design_curve import DesignCurve, explains, nearest_design
from estimation.contact.parameters import PROFILES
from estimation.contact.penalised_spline import DEGREE, PenalisedSpline, correlated_noise, fit_spline
from estimation.contact.profiles import Profile, ProfileKind
from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.units import MILLIMETRE, STD_PER_MAD


def profile_from_points(kind: ProfileKind, name: str, y: FloatArray, z: FloatArray) -> Profile:
    """Return the profile through points, its slopes those of the cubic spline through them."""
    checked = Profile(kind, name, y, z, np.zeros(len(y)))
    return Profile(kind, name, checked.y, checked.z, CubicSpline(checked.y, checked.z)(checked.y, nu=1))


def thinned(points: FloatArray) -> IntArray:
    """Return the indices of at most `PROFILES.most_points` of points (n, 2), mm, evenly spaced along the arc."""
    # Points are chosen, not averaged: each keeps the noise of the instrument, its place in the file, and whether it is
    # an outlier. The arc is that of the running mean of the points, which noise lengthens little.
    n = len(points)
    if n <= PROFILES.most_points:
        return np.arange(n)
    width = 2 * (n // PROFILES.most_points) + 1
    total = np.cumsum(np.pad(points, ((width, width - 1), (0, 0)), mode="edge"), axis=0)
    mean = (total[width:] - total[:-width]) / width
    arc = np.cumsum(np.hypot(*np.diff(mean, axis=0, prepend=mean[:1]).T))[-n:]
    share = (arc - arc[0]) / max(float(arc[-1] - arc[0]), np.finfo(np.float64).tiny)
    cell = np.minimum((share * PROFILES.most_points).astype(np.int64), PROFILES.most_points - 1)
    return np.unique(cell, return_index=True)[1].astype(np.int64)


@dataclass(frozen=True, slots=True)
class SmoothedProfile:
    """A profile and how well its shape is known."""

    profile: Profile
    noise_std: float  # m, of a point across the profile; 0 where the points are taken as they are
    outliers: tuple[int, ...] = ()  # indices of points that were left out
    spline: PenalisedSpline | None = None  # None where the points are taken as they are

    @property
    def design(self) -> DesignCurve | None:
        """The design from which the points differ by their noise only; None if there is none, or none was sought."""
        return None if self.spline is None else self.spline.design

    def draw(self, random: np.random.Generator) -> Profile:
        """Return a profile that the measurement allows: the smooth one plus an error as probable as its own."""
        if self.spline is None:
            return self.profile
        error = self.spline.root @ random.standard_normal(self.spline.coefficients.shape)
        kind, name = self.profile.kind, self.profile.name
        return _profile(kind, name, self.spline, self.spline.coefficients + error)


def exact(profile: Profile) -> SmoothedProfile:
    """Return a profile whose shape is known, as one of a drawing."""
    return SmoothedProfile(profile, 0.0)


def smoothed_profile(
    kind: ProfileKind, name: str, points: FloatArray, noise_std: float | None = None
) -> SmoothedProfile:
    """Return the smooth profile through measured points; the penalty is chosen from the points or by known noise.

    Points that are farther from the curve than 5 times the local noise are left out, one after another where they
    are alone. Points without noise (less than 0.1 um) are taken as they are. Of more than ``PROFILES.most_points`` so
    many are smoothed, evenly spaced along the arc.

    Args:
        points: (n, 2) mm, y to the field side and z down, along the profile with y increasing on the whole.
        noise_std: Known noise of the instrument, mm; 0 takes the points as they are, None estimates it.
    """
    level = correlated_noise(points)[0] if noise_std is None else noise_std
    if level < PROFILES.exact_noise:
        kept = advancing(points[:, 0], _peak(kind, points[:, 1]))
        y, z = points[kept].T * MILLIMETRE
        return SmoothedProfile(datum_at_zero(profile_from_points(kind, name, y, z)), 0.0)
    chosen = thinned(points)
    try:
        spline, weight = _without_outliers(points[chosen], level, noise_std)
    except np.linalg.LinAlgError as error:
        raise ProfileError(
            f"{len(points)} points are too few for their scatter of about {level:.2g} mm to be smoothed; give more "
            "points, or a noise of 0 to take them as they are",
            field="z",
        ) from error
    counted = weight > 0.0
    design = nearest_design(kind, points[chosen][counted])
    local = np.sqrt(np.nanmean(_windows(spline.residual[counted] ** 2, PROFILES.middle_neighbours), axis=1))
    if design and explains(design, points[chosen][counted], local, correlated_noise(points[chosen])[1]):
        spline = fit_spline(points[chosen], weight, noise_std, design)
    profile = _profile(kind, name, spline, spline.coefficients)
    outliers = tuple(int(index) for index in chosen[weight == 0.0])
    return SmoothedProfile(profile, spline.noise_std * MILLIMETRE, outliers, spline)


def _without_outliers(points: FloatArray, level: float, noise_std: float | None) -> tuple[PenalisedSpline, FloatArray]:
    weight = without_spikes(points, level)
    spline = fit_spline(points, weight, noise_std)
    for _ in range(PROFILES.outlier_rounds):
        limit = _limit(spline.residual, weight)
        magnitude = np.where(weight > 0.0, np.abs(spline.residual), 0.0)
        farthest = magnitude >= np.nanmax(_windows(magnitude, PROFILES.outlier_neighbours), axis=1)
        far = (weight > 0.0) & (np.abs(spline.residual) > limit) & farthest
        if not far.any():
            break
        weight[far] = 0.0
        spline = fit_spline(points, weight, noise_std)
    back = (weight == 0.0) & (np.abs(spline.residual) <= _limit(spline.residual, weight))
    if back.any():  # they were far from a curve that an outlier had bent
        weight[back] = 1.0
        spline = fit_spline(points, weight, noise_std)
    return spline, weight


def datum_at_zero(profile: Profile) -> Profile:
    """Return a wheel with z = 0 at its tread datum, which it must reach, and a rail as it is."""
    if profile.kind == "rail":
        return profile
    level = float(profile.height(np.zeros(1))[0])
    if not np.isfinite(level):
        raise ProfileError(
            "the wheel does not reach the tread datum, 70 mm from the flange back; is it a wheel, with y in the first "
            "column? Say where its y = 0 is (--origin datum or flange-back), or measure farther out",
            field="y",
        )
    return Profile("wheel", profile.name, profile.y, profile.z - level, profile.slope)


def advancing(y: FloatArray, peak: int) -> IntArray:
    """Return the indices of the points that advance, seen from the peak (flange tip, crown) outwards to both sides."""
    right = _beyond_all_before(y[peak:])
    left = _beyond_all_before(-y[peak::-1])
    return np.concatenate([peak - left[:0:-1], peak + right])


def _beyond_all_before(y: FloatArray) -> IntArray:
    """Return the indices of the points beyond all before them, and not too close to the last of these."""
    kept = np.flatnonzero(np.concatenate([[True], y[1:] > np.maximum.accumulate(y)[:-1]]))
    while len(close := np.flatnonzero(np.diff(y[kept]) <= PROFILES.least_spacing)):
        kept = np.delete(kept, close[np.concatenate([[True], np.diff(close) > 1])] + 1)
    return kept.astype(np.int64)


def _peak(kind: ProfileKind, z: FloatArray) -> int:
    return int(np.argmax(z) if kind == "wheel" else np.argmin(z))


def _profile(kind: ProfileKind, name: str, spline: PenalisedSpline, coefficients: FloatArray) -> Profile:
    first, last = float(spline.knots[DEGREE]), float(spline.knots[-DEGREE - 1])
    arc = np.linspace(first, last, 2 + int((last - first) / PROFILES.smoothed_step))
    point, derivative = spline.at(arc, coefficients)
    (y, z), (across, down) = point.T, derivative.T
    kept = advancing(y, _peak(kind, z))
    kept = kept[across[kept] * PROFILES.steepest_smoothed > np.abs(down[kept])]
    profile = Profile(kind, name, y[kept] * MILLIMETRE, z[kept] * MILLIMETRE, down[kept] / across[kept])
    return datum_at_zero(profile)


def without_spikes(points: FloatArray, level: float) -> FloatArray:
    """Return weight 0 (n,) for points far off the median of their neighbours, beside noise of ``level``, mm; else 1."""
    n = len(points)
    index = np.clip(np.arange(n)[:, np.newaxis] + np.arange(-3, 4), 0, n - 1)
    middle = np.median(points[index], axis=1)
    distance = np.hypot(*(points - middle).T)
    reach = np.hypot(*np.median(np.abs(points[index] - middle[:, np.newaxis]), axis=1).T)
    return np.where(distance > np.maximum(8.0 * level, PROFILES.least_outlier_distance) + 3.0 * reach, 0.0, 1.0)


def _limit(residual: FloatArray, weight: FloatArray) -> FloatArray:
    magnitude = np.where(weight > 0.0, np.abs(residual), np.nan)
    local = STD_PER_MAD * np.nanmedian(_windows(magnitude, PROFILES.noise_neighbours), axis=1)
    return np.maximum(PROFILES.outlier_stds * local, PROFILES.least_outlier_distance)


def _windows(values: FloatArray, reach: int) -> FloatArray:
    padded = np.pad(values, reach, constant_values=np.nan)
    return np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
