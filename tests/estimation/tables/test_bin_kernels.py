"""The compiled sums of a bin table against plain ones, bit for bit where only the order of additions matters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.moments import collect
from oracles.regression import both_equations
from oracles.regression import regression as plain_regression
from same_values import same_values

from estimation.tables import bin_table
from estimation.tables.bin_table import LATERAL_COLUMNS, NOISE, BinParameters, fill_cells, group_of
from estimation.values.arrays import FloatArray, IntArray
from estimation.values.windows import OF_FRAME, Motion
from estimation.vehicle.regressors import LATERAL_TARGETS, YAW_TARGET_COLUMNS, YAW_TARGETS, Signals
from fleet_db.packed_values import pack_bin_table

SINGLE = BinParameters(difference_noise=1e-9)
BOGIE = replace(SINGLE, wheelbase=2.5)


def motion_of(seed: int, n: int, *, in_bogie: bool) -> Motion:
    """Return a motion of noise, some of it outside the bins, unknown, standing, or of no block."""
    rng = np.random.default_rng(seed)
    names = [name for name in Signals._fields if in_bogie or name not in OF_FRAME]
    values = {name: 1e-2 * rng.standard_normal(n) for name in (*names, "displacement")}
    values["displacement"] *= 0.4
    values["displacement"][rng.random(n) < 0.05] = np.nan
    values["speed"] = np.where(rng.random(n) < 0.05, np.nan, rng.uniform(10.0, 40.0, n))
    valid = (rng.random(n) < 0.9) & np.isfinite(values["speed"])
    block = np.where(rng.random(n) < 0.05, -1, rng.integers(80_000_000, 80_000_000 + 40, n).cumsum() // n)
    ratio, noise = rng.uniform(0.8, 1.2), rng.uniform(0.0, 1e-7)
    shared = {"band_limited": True, "stiffness_ratio": ratio, "displacement_noise": noise}
    return Motion(**values, valid=valid, block=block, **shared)


def plain_group(block: IntArray, groups: int) -> IntArray:
    turn = (block // groups).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(32)
    return np.asarray((block + (turn * np.uint64(groups) >> np.uint64(32)).astype(np.int64)) % groups)


def plain_moments(motion: Motion, parameters: BinParameters) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return weight and moments of all cells, array by array."""
    edges = parameters.edges
    bins = len(edges) - 1
    position = (motion.displacement - edges[0]) / parameters.width
    inside = motion.valid & (motion.block >= 0) & np.isfinite(position) & (position >= 0) & (position < bins)
    index = np.where(inside, position, 0.0).astype(np.int64)
    u = position - index - 0.5
    cell = np.where(inside, plain_group(motion.block, parameters.groups) * bins + index, -1)
    equations = both_equations(motion, parameters.vehicle, parameters.difference_noise, parameters.wheelbase or 1.0)
    x1, x2 = equations.lateral.T
    *first, c = equations.yaw.T
    targets = equations.yaw_targets.copy()
    targets[:, YAW_TARGETS.index("noise")] += c * bin_table.fast_noise(targets[:, 0] / c, inside)
    cells = parameters.groups * bins
    lateral = collect(np.column_stack([x1, x1 * u, x2, x2 * u]), equations.lateral_targets, cell, cells)
    yaw = collect(np.column_stack([*first, c, c * u, c * u * u]), targets, cell, cells)
    return lateral.weight, lateral.packed, yaw.packed


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 3000), in_bogie=st.booleans())
def test_filled_cells_have_the_sums_of_plain_arrays(seed: int, n: int, *, in_bogie: bool) -> None:
    motion, parameters = motion_of(seed, n, in_bogie=in_bogie), BOGIE if in_bogie else SINGLE
    weight, lateral, yaw = plain_moments(motion, parameters)
    found = fill_cells(motion, parameters)
    np.testing.assert_array_equal(found.cells, np.flatnonzero(weight))
    np.testing.assert_array_equal(found.weight, weight[found.cells])
    np.testing.assert_array_equal(found.lateral, lateral[found.cells])
    np.testing.assert_array_equal(found.yaw, yaw[found.cells])
    assert found.samples == weight.sum()
    table = bin_table.tabulate(motion, parameters)
    assert same_values(table, found.table())
    assert pack_bin_table(table) == pack_bin_table(found)


@settings(max_examples=25)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 300), in_bogie=st.booleans())
def test_equations_are_those_of_plain_arrays(seed: int, n: int, *, in_bogie: bool) -> None:
    motion = motion_of(seed, n, in_bogie=in_bogie)
    arguments = (motion, SINGLE.vehicle, 3e-9, 2.5)
    found, expected = both_equations(*arguments), plain_regression(*arguments)
    for name in ("lateral", "lateral_targets", "yaw", "yaw_targets"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-12, err_msg=name)


@given(blocks=st.lists(st.integers(0, 2**40), max_size=20), groups=st.integers(4, 40))
def test_groups_are_those_of_plain_arrays(blocks: list[int], groups: int) -> None:
    array = np.array(blocks, np.int64)
    np.testing.assert_array_equal(group_of(array, groups), plain_group(array, groups))


def test_columns_are_as_the_equations_have_them() -> None:
    assert 4 + len(LATERAL_TARGETS) == LATERAL_COLUMNS
    assert YAW_TARGETS[NOISE] == "noise"
    assert len(YAW_TARGETS) == YAW_TARGET_COLUMNS


@pytest.mark.parametrize("parameters", [SINGLE, BOGIE])
def test_a_motion_without_a_sample_in_the_bins_fills_no_cell(parameters: BinParameters) -> None:
    motion = motion_of(1, 50, in_bogie=parameters is BOGIE)
    far = replace(motion, displacement=np.full(50, 1.0))
    found = fill_cells(far, parameters)
    assert (found.samples, len(found.cells)) == (0, 0)
    assert same_values(bin_table.merge_all([found], parameters).weight, bin_table.init(parameters).weight)
