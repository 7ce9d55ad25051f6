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
from estimation.geometry.model_fit import ModelFit, displaced, mismatch, model_fit
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.tables.bin_table import bin_parameters, cells_of_window, merge_all
from estimation.values.geometry import BinTable, Contradiction, FilledCells
from estimation.values.quantities import Status
from estimation.values.reasons import Reason, ReasonCode, code_of
from estimation.values.windows import Window
from estimation.vehicle.vehicle_class import VehicleClass

STIFFNESS_STD, CREEP_STD = 0.05, 0.10


def table_of(found: list[Window], vehicle_class: VehicleClass) -> BinTable:
    parameters = bogie_run.parameters(vehicle_class)
    tables = []
    for window in found:
        one = cells_of_window(window, alignment(track(1)), parameters)
        assert isinstance(one, FilledCells), one
        tables.append(one)
    return merge_all(tables, bin_parameters(parameters))


def fit_of(found: list[Window], vehicle_class: VehicleClass) -> ModelFit:
    parameters = bin_parameters(bogie_run.parameters(vehicle_class))
    fit = model_fit(table_of(found, vehicle_class), parameters, uncertainty=ParameterUncertainty())
    assert fit is not None
    return fit


def verdict(found: list[Window], vehicle_class: VehicleClass) -> ReasonCode | None:
    in_bogie = vehicle_class.bogie is not None
    said = mismatch(
        fit_of(found, vehicle_class), STIFFNESS_STD, CREEP_STD, in_bogie=in_bogie, uncertainty=ParameterUncertainty()
    )
    return None if said is None else said.reason.code


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
    assert mismatch(fit, STIFFNESS_STD, CREEP_STD, in_bogie=True, uncertainty=ParameterUncertainty()) is None


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
         displaced: float = 0.0, in_bogie: bool = True) -> tuple[ReasonCode, bool] | None:  # fmt: skip
    """Return what is contradicted, and whether that is certain."""
    found = mismatch(
        ModelFit(error, std, misfit, displaced), stiffness, creep, in_bogie=in_bogie, uncertainty=ParameterUncertainty()
    )
    return None if found is None else (found.reason.code, found.certain)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_spring_error_is_bounded_by_its_stds(sign: float) -> None:
    """Its own, 2 % of the sensors (6 % in a bogie), and that of stiffness and creep: half of it in a bogie."""
    for total, given in (
        (0.06, {}),
        (np.hypot(0.1, 0.06), {"std": 0.1}),
        (np.hypot(0.06, 0.5 * 0.2), {"stiffness": 0.2}),
        (np.hypot(0.06, 0.5 * 0.2), {"creep": 0.2}),
        (np.hypot(0.02, 0.2), {"stiffness": 0.2, "in_bogie": False}),
    ):
        assert code(sign * 1.75 * total, **given) is None
        assert code(sign * 1.85 * total, **given) == (ReasonCode.YAW_SPRING_DIFFERS, False)
        assert code(sign * 2.15 * total, **given) == (ReasonCode.YAW_SPRING_DIFFERS, False)
        assert code(sign * 2.25 * total, **given) == (ReasonCode.YAW_SPRING_DIFFERS, True)


@pytest.mark.parametrize("displaced", [0.0, 0.3])
def test_a_misfit_may_be_what_the_displacement_is_wrong_by_and_more(displaced: float) -> None:
    for most, below, beyond in (
        (0.55, None, (ReasonCode.MOTION_UNEXPLAINED, False)),
        (0.65, (ReasonCode.MOTION_UNEXPLAINED, False), (ReasonCode.MOTION_UNEXPLAINED, True)),
    ):
        limit = np.sqrt(most**2 + displaced)
        assert code(0.0, misfit=limit - 0.01, displaced=displaced) == below
        assert code(0.0, misfit=limit + 0.01, displaced=displaced) == beyond
    found = mismatch(ModelFit(1.0, 0.0, 2.0), 0.0, 0.0, in_bogie=True, uncertainty=ParameterUncertainty())
    assert found is not None
    assert "+100%" in found.reason.text
    assert found.relative == 1.0


def test_an_uncertain_track_may_explain_what_it_spoils() -> None:
    bins = bin_parameters(bogie_run.parameters(of_bogie(SOFT)))
    known, open_track = (
        model_fit(soft_table(), bins, noise, uncertainty=ParameterUncertainty()) for noise in (0.0, 1e-3)
    )
    assert known is not None
    assert open_track is not None
    assert known.displacement_error == 0.0
    assert 0.1 < open_track.displacement_error < 1.0
    assert open_track.spring_error_std > 5.0 * known.spring_error_std
    assert open_track.spring_error == known.spring_error


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
    assert model_fit(only(5, 201.0), bins, uncertainty=ParameterUncertainty()) is not None
    assert model_fit(only(5, 199.0), bins, uncertainty=ParameterUncertainty()) is None
    assert model_fit(only(4, 201.0), bins, uncertainty=ParameterUncertainty()) is None
    assert model_fit(only(5, 201.0, groups=4), bins, uncertainty=ParameterUncertainty()) is None


def test_the_noise_of_the_sensors_is_no_misfit() -> None:
    """With as much noise as the class says, a stiff bogie has a misfit only where the noise is not on file."""
    noisy = of_bogie(COACH)
    quiet = replace(noisy, sensors=replace(noisy.sensors, yaw=replace(noisy.sensors.yaw, noise_density=0.0)))
    assert fit_of(joined(COACH, 1), noisy).misfit < 0.5 * fit_of(joined(COACH, 1), quiet).misfit


def test_a_doubt_stands_beside_a_number_that_is_wider_by_it() -> None:
    bins = bin_parameters(bogie_run.parameters(of_bogie(SOFT)))
    plain = estimate_geometry(soft_table(), bins, GeometryParameters(uncertainty=ParameterUncertainty()))
    reason = Reason(ReasonCode.YAW_SPRING_DIFFERS, "in doubt")
    doubted = plain.against(Contradiction(reason, certain=False, relative=0.1))
    before, after = plain.equivalent_conicity, doubted.equivalent_conicity
    assert (doubted.status, doubted.reason, after.reason) == (Status.ESTIMATED, reason, reason)
    assert before.value is not None
    assert before.std is not None
    assert before.low is not None
    assert after.low is not None
    assert after.value == before.value
    assert after.std == pytest.approx(np.hypot(before.std, 0.1 * before.value))
    assert before.value - after.low == pytest.approx(
        np.hypot(before.value - before.low, 1.96 * 0.1 * before.value), rel=1e-4
    )
    widened = doubted.rolling_radius_difference.std**2 - plain.rolling_radius_difference.std**2
    np.testing.assert_allclose(widened, (0.1 * plain.rolling_radius_difference.value) ** 2, rtol=1e-6, atol=1e-16)
    assert plain.against(None) is plain
    withheld = plain.against(Contradiction(reason, certain=True, relative=0.1))
    assert withheld.equivalent_conicity.status is Status.MODEL_MISMATCH
    assert withheld.against(Contradiction(reason, certain=False, relative=0.1)) is withheld


def test_what_a_doubt_makes_of_the_conicity_follows_what_is_wrong() -> None:
    """In a bogie 40 % of an error of the class show as spring error."""
    for fit, in_bogie, relative in (
        (ModelFit(0.12, 0.0, 0.0), True, 0.12 / 0.4),
        (ModelFit(0.04, 0.0, 0.0), False, 0.04),
        (ModelFit(0.0, 0.0, 0.6), True, 0.5 * 0.36),
    ):
        found = mismatch(fit, 0.0, 0.0, in_bogie=in_bogie, uncertainty=ParameterUncertainty())
        assert found is not None
        assert not found.certain
        assert found.relative == pytest.approx(relative)


def test_noise_and_an_uncertain_track_leave_so_much_in_the_yaw() -> None:
    bins = bin_parameters(bogie_run.parameters(of_bogie(SOFT)))
    open_track = model_fit(soft_table(), bins, 1e-3, uncertainty=ParameterUncertainty())
    assert open_track is not None
    assert open_track.spring_error_std == pytest.approx(0.055, rel=0.05)


@pytest.mark.parametrize(("share", "relative"), [(0.19, None), (0.21, 0.21 / 0.79), (0.6, 1.5), (0.9, 2.0), (1.0, 2.0)])
def test_a_displacement_that_is_mostly_error_leaves_the_conicity_open(share: float, relative: float | None) -> None:
    found = displaced(ModelFit(0.0, 0.0, 0.0, share))
    assert (None if found is None else found.relative) == (None if relative is None else pytest.approx(relative))
    if found is not None:
        assert (found.reason.code, found.certain) == (ReasonCode.CONICITY_OPEN, False)
