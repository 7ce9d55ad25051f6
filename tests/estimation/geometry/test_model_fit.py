"""Tests of fit: what is right passes, and what does not belong together is found, on a bogie over a known track."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import bogie_run
import numpy as np
import pytest
from bogie_run import COACH, SOFT, WHEELBASE, joined, of_bogie, single, windows
from paper_class import PAPER_CLASS
from smooth_wheelset import alignment, track

from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.model_fit import ModelFit, mismatch, model_fit
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.tables.bin_table import bin_parameters, merge_all, tabulate_window
from estimation.values.geometry import BinTable
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleClass

STIFFNESS_STD, CREEP_STD = 0.05, 0.10


def table_of(found: list[Window], vehicle_class: VehicleClass) -> BinTable:
    parameters = bogie_run.parameters(vehicle_class)
    tables = []
    for window in found:
        one = tabulate_window(window, alignment(track(1)), parameters)
        assert isinstance(one, BinTable), one
        tables.append(one)
    return merge_all(tables, bin_parameters(parameters))


def fit_of(found: list[Window], vehicle_class: VehicleClass) -> ModelFit:
    parameters = bin_parameters(bogie_run.parameters(vehicle_class))
    fit = model_fit(table_of(found, vehicle_class), parameters)
    assert fit is not None
    return fit


def verdict(found: list[Window], vehicle_class: VehicleClass) -> ReasonCode | None:
    in_bogie = vehicle_class.bogie is not None
    return code_of(mismatch(fit_of(found, vehicle_class), STIFFNESS_STD, CREEP_STD, in_bogie=in_bogie))


def swapped(yaw_stiffness: float, axle: int) -> list[Window]:
    """Return the windows of an axle whose node has the number of the other: its place and its frame are the other's."""
    ahead = WHEELBASE if axle == 1 else -WHEELBASE
    return [
        replace(w, distance=w.distance + ahead, frame_yaw_acceleration=-np.asarray(w.frame_yaw_acceleration))
        for w in joined(yaw_stiffness, 3 - axle)
    ]


@cache
def soft_table() -> BinTable:
    return table_of(joined(SOFT, 1), of_bogie(SOFT))


@pytest.mark.parametrize("axle", [1, 2])
@pytest.mark.parametrize("yaw_stiffness", [SOFT, COACH])
def test_what_is_right_passes(yaw_stiffness: float, axle: int) -> None:
    fit = fit_of(joined(yaw_stiffness, axle), of_bogie(yaw_stiffness))
    assert abs(fit.spring_error) < 0.03
    assert fit.misfit < 0.4
    assert mismatch(fit, STIFFNESS_STD, CREEP_STD, in_bogie=True) is None


@pytest.mark.parametrize("axle", [1, 2])
@pytest.mark.parametrize("yaw_stiffness", [SOFT, COACH])
def test_another_wheelbase_is_found(yaw_stiffness: float, axle: int) -> None:
    assert verdict(joined(yaw_stiffness, axle, 1.8), of_bogie(yaw_stiffness, 1.8)) is ReasonCode.YAW_SPRING_DIFFERS


@pytest.mark.parametrize("axle", [1, 2])
@pytest.mark.parametrize("yaw_stiffness", [SOFT, COACH])
def test_swapped_nodes_are_found(yaw_stiffness: float, axle: int) -> None:
    assert verdict(swapped(yaw_stiffness, axle), of_bogie(yaw_stiffness)) is ReasonCode.YAW_SPRING_DIFFERS


@pytest.mark.parametrize(("yaw_stiffness", "axle"), [(SOFT, 1), (SOFT, 2), (COACH, 1)])
def test_a_bogie_on_file_as_the_vehicle_of_the_paper_is_found(yaw_stiffness: float, axle: int) -> None:
    for assumed in (PAPER_CLASS, single(SOFT)):
        assert verdict(list(windows(yaw_stiffness, axle)), assumed) is ReasonCode.YAW_SPRING_DIFFERS


def test_a_stiff_bogie_whose_curve_takes_up_the_moment_is_found_by_what_it_leaves() -> None:
    for assumed in (PAPER_CLASS, single(SOFT)):
        assert verdict(list(windows(COACH, 2)), assumed) is ReasonCode.MOTION_UNEXPLAINED


def test_a_mismatch_ends_the_geometry() -> None:
    wrong = of_bogie(SOFT, 1.8)
    bins = bin_parameters(bogie_run.parameters(wrong))
    table = table_of(joined(SOFT, 1, 1.8), wrong)
    geometry = estimate_geometry(table, bins, GeometryParameters(uncertainty=ParameterUncertainty()))
    assert geometry.status is geometry.equivalent_conicity.status is Status.MODEL_MISMATCH
    assert code_of(geometry.reason) is ReasonCode.YAW_SPRING_DIFFERS
    right = bin_parameters(bogie_run.parameters(of_bogie(SOFT)))
    good = estimate_geometry(soft_table(), right, GeometryParameters(uncertainty=ParameterUncertainty()))
    assert good.status is Status.ESTIMATED


def code(error: float, std: float = 0.0, misfit: float = 0.0, *, stiffness: float = 0.0, creep: float = 0.0,
         in_bogie: bool = True) -> ReasonCode | None:  # fmt: skip
    return code_of(mismatch(ModelFit(error, std, misfit), stiffness, creep, in_bogie=in_bogie))


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_spring_error_is_bounded_by_its_stds(sign: float) -> None:
    """Its own, 2 % of the sensors (6 % in a bogie), and that of stiffness and creep: half of it in a bogie."""
    for most, given in (
        (2.2 * 0.06, {}),
        (2.2 * np.hypot(0.1, 0.06), {"std": 0.1}),
        (2.2 * np.hypot(0.06, 0.5 * 0.2), {"stiffness": 0.2}),
        (2.2 * np.hypot(0.06, 0.5 * 0.2), {"creep": 0.2}),
        (2.2 * np.hypot(0.02, 0.2), {"stiffness": 0.2, "in_bogie": False}),
    ):
        assert code(sign * 0.98 * most, **given) is None
        assert code(sign * 1.02 * most, **given) is ReasonCode.YAW_SPRING_DIFFERS


def test_a_misfit_of_two_thirds_is_too_much() -> None:
    assert code(0.0, misfit=0.64) is None
    assert code(0.0, misfit=0.66) is ReasonCode.MOTION_UNEXPLAINED
    found = mismatch(ModelFit(1.0, 0.0, 2.0), 0.0, 0.0, in_bogie=True)
    assert isinstance(found, Reason)
    assert "+100%" in found.text


def only(bins: int, samples: float, groups: int = 16) -> BinTable:
    """Return the table with so many bins, groups, and samples of a bin."""
    table = soft_table()
    best = np.argsort(table.weight.sum(axis=0))[-bins:]
    weight = np.zeros(table.weight.shape)
    kept = np.flatnonzero(table.weight.sum(axis=1))[:groups]
    assert len(kept) == min(groups, len(kept))
    weight[np.ix_(kept, best)] = samples / len(kept)
    return replace(table, weight=weight)


def test_five_bins_of_two_hundred_samples_and_five_groups_are_needed() -> None:
    bins = bin_parameters(bogie_run.parameters(of_bogie(SOFT)))
    assert model_fit(only(5, 201.0), bins) is not None
    assert model_fit(only(5, 199.0), bins) is None
    assert model_fit(only(4, 201.0), bins) is None
    assert model_fit(only(5, 201.0, groups=4), bins) is None


def test_the_noise_of_the_sensors_is_no_misfit() -> None:
    """With as much noise as the class says, a stiff bogie has a misfit only where the noise is not on file."""
    noisy = of_bogie(COACH)
    quiet = replace(noisy, sensors=replace(noisy.sensors, yaw=replace(noisy.sensors.yaw, noise_density=0.0)))
    assert fit_of(joined(COACH, 1), noisy).misfit < 0.5 * fit_of(joined(COACH, 1), quiet).misfit
