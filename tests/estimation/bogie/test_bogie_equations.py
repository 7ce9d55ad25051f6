"""The normal equations of a bogie against dense least squares, and who is who where the rear axle leads."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bogie_case import CONES, GEAR, runs

from estimation.bogie.curves import Curves, nodes
from estimation.bogie.equations import PARAMETERS
from estimation.bogie.signals import Followed
from estimation.bogie.sums import UNKNOWNS, Spectra, error_spectrum, normal, spectra, unknowns_by_axle

B = len(nodes())
FOLLOWED = Followed(np.ones(2), np.zeros(2), 0.0)


def _drawn(seed: int, unknowns: int = 5, segments: int = 3, m: int = 40) -> Spectra:
    rng = np.random.default_rng(seed)
    shape = (segments, 3, 1 + unknowns, m)
    measured = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    return Spectra(measured, measured[:, :, 1:], FOLLOWED, np.ones((2, B)), 0)


def test_with_own_columns_as_instruments_it_is_dense_least_squares() -> None:
    part, rng = _drawn(1), np.random.default_rng(2)
    factor = rng.standard_normal((40, 3, 3)) + 1j * rng.standard_normal((40, 3, 3))
    covariance = factor @ factor.conj().transpose(0, 2, 1) + 0.1 * np.eye(3)
    scale = np.array([1.0, 2.0, 0.5])
    left, right = normal(part, covariance, scale)
    whiten = np.linalg.inv(np.linalg.cholesky(covariance))
    rows, wanted = [], []
    for segment, size in zip(part.measured, scale, strict=True):
        white = np.einsum("mef,fum->meu", whiten, segment).reshape(-1, 6) / np.sqrt(size)
        rows += [white[:, 1:].real, white[:, 1:].imag]
        wanted += [-white[:, 0].real, -white[:, 0].imag]
    dense = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    assert np.allclose(np.linalg.solve(left, -right), dense, rtol=1e-9)


def test_noise_in_what_multiplies_the_unknowns_does_not_shrink_them() -> None:
    rng, true = np.random.default_rng(4), np.array([1.0, -2.0])
    shape = (400, 3, 2, 40)
    clean = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    target = -np.einsum("seum,u->sem", clean, true)
    noisy = clean + rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    measured = np.concatenate([target[:, :, None], noisy], axis=2)
    covariance, scale = np.tile(np.eye(3, dtype=np.complex128), (40, 1, 1)), np.ones(400)
    found = [
        np.linalg.solve(left, -right)
        for instruments in (clean, noisy)
        for left, right in [normal(Spectra(measured, instruments, FOLLOWED, np.ones((2, B)), 0), covariance, scale)]
    ]
    assert np.allclose(found[0], true, rtol=0.03)
    assert np.allclose(found[1], 0.5 * true, rtol=0.03)


def test_the_covariance_of_the_errors_is_found_with_the_power_of_each_segment() -> None:
    rng, m = np.random.default_rng(7), 200
    mixing = np.array([[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, -0.7, 0.3]])
    shape = (300, 3, m)
    errors = np.einsum("ef,sfm->sem", mixing, rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    errors[:150] *= 3.0
    measured = np.concatenate([errors[:, :, None], np.zeros((300, 3, 1, m))], axis=2)
    found = error_spectrum([Spectra(measured, measured[:, :, 1:], FOLLOWED, np.ones((2, B)), 0)], np.zeros(1))
    ratio = found.scale[0][:150].mean() / found.scale[0][150:].mean()
    assert ratio == pytest.approx(9.0, rel=0.05)
    shape_found = found.covariance.mean(axis=0)
    expected = 2.0 * mixing @ mixing.T
    assert np.allclose(shape_found / shape_found[0, 0], expected / expected[0, 0], atol=0.1)


def test_unknowns_of_a_bogie_whose_rear_axle_leads_are_those_of_the_other_axle() -> None:
    place = unknowns_by_axle(B)
    assert np.array_equal(place[place], np.arange(UNKNOWNS + 2 * B))
    assert place[PARAMETERS.index("yaw_scale_front")] == PARAMETERS.index("yaw_scale_rear")
    assert place[PARAMETERS.index("yaw_stiffness")] == PARAMETERS.index("yaw_stiffness")
    assert place[UNKNOWNS] == UNKNOWNS + B


def test_a_run_with_the_rear_axle_ahead_has_the_columns_of_its_wheelsets_exchanged() -> None:
    ((_, run),) = runs(1, 1)
    curves = Curves(np.stack([2 * cone * nodes() for cone in CONES]))
    ahead = spectra(GEAR, curves, run, 0)
    behind = spectra(GEAR, Curves(curves.values[::-1]), replace(run, swapped=True), 0)
    assert ahead is not None
    assert behind is not None
    place = unknowns_by_axle(B)
    assert np.array_equal(behind.simulated, ahead.simulated[:, :, place])
    assert np.array_equal(behind.measured[:, :, 1:], ahead.measured[:, :, 1:][:, :, place])
    assert np.array_equal(behind.visited, ahead.visited[::-1])
    assert np.array_equal(behind.followed.likeness, ahead.followed.likeness[::-1])
