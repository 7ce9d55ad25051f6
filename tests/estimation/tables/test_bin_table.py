"""Bin tables: right against the truth and an oracle, and the same for any split and order."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.regression import both_equations
from same_values import same_values
from smooth_wheelset import SmoothTable, ideal, run

from estimation.errors import ParameterError
from estimation.tables import bin_table
from estimation.tables.bin_table import solve
from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinTable, FilledCells
from estimation.values.windows import Motion
from estimation.vehicle.regressors import YAW_TARGETS, regression
from estimation.vehicle.vehicle_class import VehicleParameters

PARAMETERS = bin_table.BinParameters()


def _slice(motion: Motion, part: slice) -> Motion:
    values = {name: getattr(motion, name) for name in Motion.__slots__}
    return Motion(**{k: v[part] if isinstance(v, np.ndarray) else v for k, v in values.items()})


def test_the_equations_hold_on_the_true_geometry() -> None:
    """Regressors times the true S, D, A, R give the targets, sample by sample."""
    m = run(60)
    eq = both_equations(ideal(m), VehicleParameters())
    S, R = m.rolling_radius_left + m.rolling_radius_right, m.rolling_radius_left - m.rolling_radius_right
    A, D = m.contact_angle_left + m.contact_angle_right, m.contact_angle_left - m.contact_angle_right
    lateral = eq.lateral_targets[:, 0] - S * eq.lateral[:, 0] - D * eq.lateral[:, 1]
    # the yaw equation carries S through the small spin term only, taken at S = 2 r0
    yaw = eq.yaw_targets[:, 0] - A * eq.yaw[:, 0] - R * eq.yaw[:, 1]
    assert np.abs(lateral).max() < 1e-6 * np.abs(eq.lateral_targets[:, 0]).max()
    assert np.abs(yaw).max() < 1e-4 * np.abs(eq.yaw_targets[:, 0]).max()


def test_sensitivities_are_derivatives_by_the_logarithm_of_the_parameter() -> None:
    motion = ideal(run(20))
    p = VehicleParameters()
    base = both_equations(motion, p)
    h = 1e-6
    for column, name in ((4, "load"), (5, "lateral_stiffness"), (6, "lateral_damping"), (3, "wheelset_mass")):
        moved = both_equations(motion, replace(p, **{name: getattr(p, name) * (1 + h)}))
        change = (moved.lateral_targets[:, 0] - base.lateral_targets[:, 0]) / h
        np.testing.assert_allclose(change, base.lateral_targets[:, column], rtol=1e-3, atol=1e-2)
    moved = both_equations(motion, replace(p, yaw_stiffness=p.yaw_stiffness * (1 + h)))
    change = (moved.yaw_targets[:, 0] - base.yaw_targets[:, 0]) / h
    np.testing.assert_allclose(change, base.yaw_targets[:, 2], rtol=1e-3, atol=1e-2)


def test_a_bin_equals_least_squares_on_its_samples() -> None:
    motion = ideal(run(60))
    table = bin_table.tabulate(motion, PARAMETERS)
    eq = regression(motion, PARAMETERS.vehicle)
    b = int(np.searchsorted(table.edges, 0.6e-3)) - 1
    inside = (motion.displacement >= table.edges[b]) & (motion.displacement < table.edges[b + 1])
    u = (motion.displacement[inside] - 0.5 * (table.edges[b] + table.edges[b + 1])) / PARAMETERS.width
    a, c = eq.yaw[inside].T
    X = np.column_stack([a, c, c * u, c * u**2])
    expected, *_ = np.linalg.lstsq(X / np.linalg.norm(X, axis=0), eq.yaw_targets[inside, 0], rcond=None)
    theta = solve(table.yaw.sum(axis=0), table.weight.sum(axis=0), 4, len(YAW_TARGETS)).theta[b, :, 0]
    np.testing.assert_allclose(theta, expected / np.linalg.norm(X, axis=0), rtol=1e-6)
    assert table.weight.sum(axis=0)[b] == inside.sum()


@settings(max_examples=15)
@given(cuts=st.lists(st.integers(0, 60_000), max_size=6), order=st.randoms(use_true_random=False))
def test_any_split_in_any_order_gives_the_same_table(cuts: list[int], order: object) -> None:
    motion = ideal(run(60))
    whole = bin_table.tabulate(motion, PARAMETERS)
    bounds = [0, *sorted(cuts), 60_000]
    parts = [bin_table.tabulate(_slice(motion, slice(a, b)), PARAMETERS) for a, b in pairwise(bounds)]
    order.shuffle(parts)  # type: ignore[attr-defined]
    merged = bin_table.merge_all(parts, PARAMETERS)
    assert merged.samples == whole.samples
    np.testing.assert_array_equal(merged.weight, whole.weight)
    np.testing.assert_allclose(merged.lateral, whole.lateral, rtol=1e-9, atol=1e-9 * np.abs(whole.lateral).max())
    np.testing.assert_allclose(merged.yaw, whole.yaw, rtol=1e-9, atol=1e-9 * np.abs(whole.yaw).max())


def test_the_same_order_gives_the_same_bits() -> None:
    motion = ideal(run(60))
    parts = [bin_table.tabulate(_slice(motion, slice(k, k + 20_000)), PARAMETERS) for k in (0, 20_000, 40_000)]
    assert same_values(bin_table.merge_all(parts, PARAMETERS), bin_table.merge_all(parts, PARAMETERS))


def test_a_sum_goes_on_from_any_sum_and_takes_weights() -> None:
    motion = ideal(run(60))
    parts = [bin_table.tabulate(_slice(motion, slice(k, k + 20_000)), PARAMETERS) for k in (0, 20_000, 40_000)]
    whole = bin_table.weighted_sum([(1.0, parts[0]), (0.5, parts[1]), (0.25, parts[2])])
    np.testing.assert_allclose(whole.weight, parts[0].weight + 0.5 * parts[1].weight + 0.25 * parts[2].weight)
    further = bin_table.TableSum(bin_table.weighted_sum([(1.0, parts[0]), (0.5, parts[1])]))
    further.add(filled_cells(parts[2]), 0.25)
    assert same_values(further.table(), whole)
    with pytest.raises(ValueError, match="no table"):
        bin_table.weighted_sum([])


def test_filled_cells_are_the_table() -> None:
    tables = [bin_table.tabulate(ideal(run(10, seed=seed)), PARAMETERS) for seed in (1, 2)]
    filled = [filled_cells(table) for table in tables]
    assert 0 < len(filled[0].cells) < filled[0].groups * len(tables[0].centres)
    for one, table in zip(filled, tables, strict=True):
        assert same_values(one.table(), table)
    mixed = bin_table.merge_all([filled[0], tables[1]], PARAMETERS)
    assert same_values(mixed, bin_table.merge_all(tables, PARAMETERS))
    empty = filled_cells(bin_table.init(PARAMETERS))
    assert same_values(bin_table.merge_all([empty], PARAMETERS), bin_table.init(PARAMETERS))


def filled_cells(table: BinTable) -> FilledCells:
    cells = np.flatnonzero(table.weight.reshape(-1))

    def rows(array: FloatArray) -> FloatArray:
        return array.reshape(-1, *array.shape[2:])[cells]

    sums = rows(table.weight), rows(table.lateral), rows(table.yaw)
    return FilledCells(table.parameter_key, table.edges, len(table.weight), cells, *sums, table.samples, table.windows)


@pytest.mark.parametrize("cells", [[-1, 4], [4, 16 * 57]])
def test_filled_cells_lie_in_the_table(cells: list[int]) -> None:
    edges = bin_table.init(PARAMETERS).edges
    with pytest.raises(ValueError, match=r"cells .* of 912"):
        FilledCells("key", edges, 16, np.array(cells), np.ones(2), np.ones((2, 3)), np.ones((2, 4)), 2, 1)


def test_a_sum_takes_no_table_of_other_parameters() -> None:
    with pytest.raises(ValueError, match="do not merge"):
        bin_table.merge_all([bin_table.init(replace(PARAMETERS, width=0.5e-3))], PARAMETERS)


def test_samples_outside_the_bins_or_not_valid_are_left_out() -> None:
    motion = ideal(run(20))
    values = {name: getattr(motion, name) for name in Motion.__slots__}
    x = motion.displacement.copy()
    x[:100], x[100:200], x[200] = 0.5, -0.5, np.nan
    valid = motion.valid.copy()
    valid[300:400] = False
    table = bin_table.tabulate(Motion(**{**values, "displacement": x, "valid": valid}), PARAMETERS)
    assert table.samples == len(motion) - 301


@pytest.mark.parametrize("change", [{"width": 0.0}, {"width": 1.0}, {"groups": 3}])
def test_impossible_parameters_are_refused(change: dict[str, float]) -> None:
    with pytest.raises(ParameterError):
        replace(PARAMETERS, **change)


def test_all_four_combinations_are_found_from_ideal_signals() -> None:
    """The claim of science: locally linear bins find what constant bins cannot (the contact angle sum)."""
    table = bin_table.tabulate(ideal(run(200)), PARAMETERS)
    truth = SmoothTable()
    x = table.centres
    n = table.weight.sum(axis=0)
    good = n > 2000
    lateral = solve(table.lateral.sum(axis=0), n, 4, 7).theta[good]
    yaw = solve(table.yaw.sum(axis=0), n, 4, len(YAW_TARGETS)).theta[good]
    x = x[good]
    assert good.sum() > 15
    S, D = lateral[:, 0, 0], lateral[:, 2, 0]
    A, R = yaw[:, 0, 0], yaw[:, 1, 0]
    assert np.abs(S - truth.left(x) - truth.right(x)).max() < 2e-6
    assert np.abs(R - truth.left(x) + truth.right(x)).max() < 2e-6
    assert np.abs(D - truth.angle_left(x) + truth.angle_right(x)).max() < 1e-3
    assert np.abs(A - truth.angle_left(x) - truth.angle_right(x)).max() < 4e-3
