"""Measured points: smoothing by their own noise, outliers, corners, and the std of the conicity that follows."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from estimation.contact.conicity import MeasuredShapes, conicity_std, equivalent_conicity
from estimation.contact.geometry import WheelsetOnTrack, radius_difference_curve
from estimation.contact.method import ContactMethod
from estimation.contact.penalised_spline import correlated_noise, rough_noise
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.smoothed_profile import SmoothedProfile, exact, smoothed_profile
from estimation.contact.surfaces import wheel_surface
from estimation.errors import ContactError, ProfileError
from estimation.values.arrays import FloatArray

NOISE = 0.02  # mm
AMPLITUDES = np.array([2e-3, 3e-3, 4e-3])
PINNED_STD = [0.00531, 0.00194, 0.00183]
PINNED_STD_OF_A_DESIGN = [0.00226, 0.00130, 0.00118]
GRID = np.linspace(-6e-3, 6e-3, 121)
S1002, RAIL = wheel_profile("S1002"), rail_profile("60E1")


def points_along(profile: Profile, spacing: float = 0.15) -> FloatArray:
    y, z = profile.y * 1e3, profile.z * 1e3
    arc = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(y), np.diff(z)))])
    across = np.interp(np.arange(0.0, arc[-1], spacing), arc, y)
    return np.column_stack([across, np.interp(across, y, z)])


def noisy(profile: Profile, seed: int, *, spacing: float = 0.15, across: float = 0.0) -> FloatArray:
    random = np.random.default_rng(seed)
    points = points_along(profile, spacing)
    points[:, 1] += random.normal(0.0, NOISE, len(points))
    points[:, 0] += random.normal(0.0, across, len(points)) if across else 0.0
    return points


def conicity(wheel: Profile) -> FloatArray:
    curve = radius_difference_curve(on_rail(wheel), GRID, method=ContactMethod.EN15302)
    return equivalent_conicity(curve.displacement, curve.difference, AMPLITUDES)


def on_rail(wheel: Profile) -> WheelsetOnTrack:
    return WheelsetOnTrack.symmetric(wheel, RAIL, 1 / 40, 1.435)


def std_of(shape: SmoothedProfile, draws: int = 12) -> FloatArray:
    rail = exact(RAIL)
    shapes = MeasuredShapes(shape, shape, rail, rail)
    return conicity_std(on_rail(shape.profile), shapes, GRID, AMPLITUDES, draws=draws)


@pytest.mark.parametrize("across", [0.0, NOISE])
def test_noise_moves_the_conicity_by_less_than_a_hundredth_and_no_more_than_its_std_says(across: float) -> None:
    truth = conicity(S1002)
    for seed in range(2):
        shape = smoothed_profile("wheel", "measured", noisy(S1002, seed, across=across))
        error, std = conicity(shape.profile) - truth, std_of(shape)
        assert np.abs(error).max() < 0.01
        assert (np.abs(error) < 3.5 * std).all()
        assert (std < 0.01).all()
        assert shape.noise_std == pytest.approx(np.hypot(NOISE, across) * 0.75e-3, rel=0.2)
        assert not shape.outliers


def test_points_without_noise_are_taken_as_they_are() -> None:
    points = points_along(S1002)
    shape = smoothed_profile("wheel", "exact", points)
    assert (shape.noise_std, shape.spline) == (0.0, None)
    np.testing.assert_allclose(shape.profile.z, points[:, 1] * 1e-3 - shape.profile.z[0] * 0, atol=1e-6)
    assert shape.draw(np.random.default_rng(0)) is shape.profile
    assert std_of(shape).tolist() == [0.0, 0.0, 0.0]
    forced = smoothed_profile("wheel", "noisy", noisy(S1002, 0), 0.0)
    assert forced.spline is None
    assert np.abs(np.diff(forced.profile.slope)).max() > 0.1


def worn(points: FloatArray) -> FloatArray:
    """Return points that are no longer a design: 0.1 mm are taken off the tread."""
    return points - np.outer(np.exp(-0.5 * ((points[:, 0] - 5.0) / 8.0) ** 2), [0.0, 0.1])


def test_known_noise_takes_the_place_of_the_estimated_one() -> None:
    points = worn(noisy(S1002, 3))
    small, large = (smoothed_profile("wheel", "measured", points, noise) for noise in (0.5 * NOISE, 2.0 * NOISE))
    assert (small.noise_std, large.noise_std) == (pytest.approx(1e-5), pytest.approx(4e-5))
    rough = [float(np.square(np.diff(shape.profile.slope, n=2)[1200:2200]).sum()) for shape in (small, large)]
    assert rough[0] > rough[1]


def test_outliers_are_left_out_one_by_one() -> None:
    points = noisy(S1002, 4)
    far = [200, 411, 412, 640]
    points[far, 1] += [0.4, -0.3, -0.3, 1.0]
    shape = smoothed_profile("wheel", "measured", points)
    assert shape.outliers == tuple(far)
    assert np.abs(conicity(shape.profile) - conicity(S1002)).max() < 0.01


def test_a_corner_is_kept() -> None:
    """EN 15302 wheel H bends by 0.175 at y = -10.23 mm."""
    wheel = wheel_profile("EN15302-H")
    shape = smoothed_profile("wheel", "measured", worn(noisy(wheel, 5)))
    y = np.array([-11.5, -9.0]) * 1e-3
    off = 0.1 * (y * 1e3 - 5.0) / 64.0 * np.exp(-0.5 * ((y * 1e3 - 5.0) / 8.0) ** 2)
    np.testing.assert_allclose(shape.profile.gradient(y), wheel.gradient(y) + off, atol=0.015)


def test_the_std_of_a_seed_is_pinned() -> None:
    """Every constant of the smoothing and of the draws shows here."""
    for points, pinned in ((worn(noisy(S1002, 7)), PINNED_STD), (noisy(S1002, 7), PINNED_STD_OF_A_DESIGN)):
        shape = smoothed_profile("wheel", "measured", points)
        assert std_of(shape) == pytest.approx(pinned, rel=0.03)


def test_noise_that_neighbours_share_is_recognised_and_not_followed() -> None:
    random = np.random.default_rng(6)
    points = points_along(S1002, 0.1)
    alike = np.exp(-0.1 / 0.4)
    noise = lfilter([np.sqrt(1.0 - alike**2)], [1.0, -alike], random.normal(0.0, 0.01, len(points) + 100))[100:]
    points[:, 1] += noise
    level, length = correlated_noise(points)
    assert level == pytest.approx(0.009, rel=0.3)
    assert 0.2 <= length <= 0.8
    shape = smoothed_profile("wheel", "measured", points)
    error = conicity(shape.profile) - conicity(S1002)
    assert np.abs(error).max() < 0.01
    assert (np.abs(error) < 3.5 * std_of(shape)).all()
    assert correlated_noise(noisy(S1002, 6))[1] == 0.0


def test_rough_noise_is_that_of_the_points_and_not_of_their_shape() -> None:
    assert rough_noise(points_along(S1002)) < 1e-4
    assert rough_noise(noisy(S1002, 8)) == pytest.approx(0.9 * NOISE, rel=0.15)


def test_a_steep_point_does_not_end_a_wheel() -> None:
    """Noise of 0.05 mm every 5 um makes slopes over 82 degrees; the tread stays."""
    y, slope = S1002.y.copy(), S1002.slope.copy()
    slope[2000] = 9.0
    surface = wheel_surface(Profile("wheel", "spiky", y, S1002.z, slope))
    assert surface.start + surface.step * len(surface.height) > 0.058


def test_points_that_end_before_the_datum_are_refused() -> None:
    points = noisy(S1002, 9)
    with pytest.raises(ProfileError, match="tread datum"):
        smoothed_profile("wheel", "short", points[points[:, 0] < -5.0])


def test_too_few_points_for_their_scatter_are_refused_but_for_those_who_want_them_as_they_are() -> None:
    y = np.linspace(S1002.y[0], S1002.y[-1], 12)
    points = np.column_stack([y, S1002.height(y)]) * 1e3
    with pytest.raises(ProfileError, match="12 points are too few"):
        smoothed_profile("wheel", "few", points)
    assert len(smoothed_profile("wheel", "few", points, 0.0).profile.y) == 12


def test_a_wheel_that_ends_in_its_flange_cannot_touch() -> None:
    keep = np.argmax(S1002.z) + 1
    flange = Profile("wheel", "flange", S1002.y[:keep], S1002.z[:keep], S1002.slope[:keep])
    with pytest.raises(ContactError, match="ends in its flange"):
        wheel_surface(flange)
