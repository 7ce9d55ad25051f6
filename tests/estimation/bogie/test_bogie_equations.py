"""The normal equations of a bogie against dense least squares, and who is who where the rear axle leads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bogie_case import CONES, GEAR, runs

from estimation.bogie.curves import Curves, nodes
from estimation.bogie.equations import PARAMETERS
from estimation.bogie.signals import Followed
from estimation.bogie.sums import Columns, MeasuredRun, Spectra, error_spectrum, normal, parameters_by_axle, spectra

B = len(nodes())
FOLLOWED = Followed(np.ones(2), np.zeros(2), 0.0)


def _drawn(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def _part(target: np.ndarray, measured: Columns, simulated: Columns) -> Spectra:
    return Spectra(target, measured, simulated, FOLLOWED, np.ones((2, B)), (0, 1), 0)


def _dense(columns: Columns, axles: tuple[int, int]) -> np.ndarray:
    """Return columns (s, 3, u, m) of all unknowns in all equations."""
    s, _, p, m = columns.parameters.shape
    b = columns.hats.shape[2]
    whole = np.zeros((s, 3, p + 2 * b, m), dtype=np.complex128)
    whole[:, :, :p] = columns.parameters
    for equation, axle in enumerate(axles):
        whole[:, equation, p + axle * b : p + (axle + 1) * b] = columns.hats[:, equation]
    return whole


@pytest.mark.parametrize("axles", [(0, 1), (1, 0)])
def test_with_own_columns_as_instruments_it_is_dense_least_squares(axles: tuple[int, int]) -> None:
    rng = np.random.default_rng(2)
    columns = Columns(_drawn(rng, 3, 3, 4, 40), _drawn(rng, 3, 2, 3, 40))
    part = replace(_part(_drawn(rng, 3, 3, 40), columns, columns), axles=axles)
    factor = _drawn(rng, 40, 3, 3)
    covariance = factor @ factor.conj().transpose(0, 2, 1) + 0.1 * np.eye(3)
    scale = np.array([1.0, 2.0, 0.5])
    left, right = normal(part, covariance, scale)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    rows, wanted = [], []
    for segment, target, size in zip(_dense(columns, axles), part.target, scale, strict=True):
        white = np.einsum("mef,fum->meu", whiten, segment).reshape(-1, 10) / np.sqrt(size)
        white_target = np.einsum("mef,fm->me", whiten, target).reshape(-1) / np.sqrt(size)
        rows += [white.real, white.imag]
        wanted += [-white_target.real, -white_target.imag]
    dense = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    assert np.allclose(np.linalg.solve(left, -right), dense, rtol=1e-9)


def test_columns_times_unknowns_are_those_of_the_dense_equations() -> None:
    rng = np.random.default_rng(3)
    columns, theta = Columns(_drawn(rng, 2, 3, 4, 7), _drawn(rng, 2, 2, 3, 7)), rng.standard_normal(10)
    for axles in ((0, 1), (1, 0)):
        assert np.allclose(columns.times(theta, axles), np.einsum("seum,u->sem", _dense(columns, axles), theta))


def test_noise_in_what_multiplies_the_unknowns_does_not_shrink_them() -> None:
    rng, true = np.random.default_rng(4), np.array([1.0, -2.0])
    clean, none = _drawn(rng, 400, 3, 2, 40), np.zeros((400, 2, 0, 40), dtype=np.complex128)
    target = -np.einsum("seum,u->sem", clean, true)
    noisy = Columns(clean + _drawn(rng, *clean.shape), none)
    covariance, scale = np.tile(np.eye(3, dtype=np.complex128), (40, 1, 1)), np.ones(400)
    found = [
        np.linalg.solve(left, -right)
        for instruments in (Columns(clean, none), noisy)
        for left, right in [normal(_part(target, noisy, instruments), covariance, scale)]
    ]
    assert np.allclose(found[0], true, rtol=0.03)
    assert np.allclose(found[1], 0.5 * true, rtol=0.03)


def test_the_covariance_of_the_errors_is_found_with_the_power_of_each_segment() -> None:
    rng, m = np.random.default_rng(7), 200
    mixing = np.array([[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, -0.7, 0.3]])
    errors = np.einsum("ef,sfm->sem", mixing, _drawn(rng, 300, 3, m))
    errors[:150] *= 3.0
    nothing = Columns(np.zeros((300, 3, 1, m), dtype=np.complex128), np.zeros((300, 2, 0, m), dtype=np.complex128))
    found = error_spectrum([_part(errors, nothing, nothing)], np.zeros(1))
    ratio = found.scale[0][:150].mean() / found.scale[0][150:].mean()
    assert ratio == pytest.approx(9.0, rel=0.05)
    shape_found = found.covariance.mean(axis=0)
    expected = 2.0 * mixing @ mixing.T
    assert np.allclose(shape_found / shape_found[0, 0], expected / expected[0, 0], atol=0.1)


def test_parameters_of_a_bogie_whose_rear_axle_leads_are_those_of_the_other_axle() -> None:
    place = parameters_by_axle(swapped=True)
    assert np.array_equal(place[place], np.arange(len(PARAMETERS)))
    assert place[PARAMETERS.index("yaw_scale_front")] == PARAMETERS.index("yaw_scale_rear")
    assert place[PARAMETERS.index("yaw_stiffness")] == PARAMETERS.index("yaw_stiffness")
    assert np.array_equal(parameters_by_axle(swapped=False), np.arange(len(PARAMETERS)))


def test_a_run_with_the_rear_axle_ahead_has_the_columns_of_its_wheelsets_exchanged() -> None:
    ((_, run),) = runs(1, 1)
    radius = GEAR.vehicle.nominal_radius
    curves = Curves(np.stack([2 * cone * nodes() for cone in CONES]))
    ahead = spectra(GEAR, curves, MeasuredRun.of(0, run, radius))
    behind = spectra(GEAR, Curves(curves.values[::-1]), MeasuredRun.of(0, replace(run, swapped=True), radius))
    assert ahead is not None
    assert behind is not None
    place = parameters_by_axle(swapped=True)
    for ours, theirs in ((behind.simulated, ahead.simulated), (behind.measured, ahead.measured)):
        assert np.array_equal(ours.parameters, theirs.parameters[:, :, place])
        assert np.array_equal(ours.hats, theirs.hats)
    assert (ahead.axles, behind.axles) == ((0, 1), (1, 0))
    assert np.array_equal(behind.visited, ahead.visited[::-1])
    assert np.array_equal(behind.followed.likeness, ahead.followed.likeness[::-1])
