"""The fit of a coach's bogie on a known track against the truth, and when it is refused."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bogie_case import AMPLITUDES, CLASS, runs, true_conicity
from bogie_run import COACH, SOFT, of_bogie, single

from estimation.bogie.curves import Curves, nodes
from estimation.bogie.equations import PARAMETERS
from estimation.bogie.fit import Beforehand, BogieFit, _by_law, fit_bogie
from estimation.bogie.geometry import curve_replicates, in_bins
from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import followed, placed
from estimation.bogie.sums import UNKNOWNS
from estimation.geometry.conicity import CurveEstimates, CurveParameters, curve_estimates
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.jobs.steps.bogie_geometry import FittedBogie, held_by_spring
from estimation.tables.bin_table import BinParameters
from estimation.values.reasons import Reason, ReasonCode

EDGES, RUNS = BinParameters().edges, 6


@cache
def _fitted(seed: int) -> BogieFit:
    found = fit_bogie(Beforehand.of(CLASS), runs(RUNS, seed))
    assert isinstance(found, BogieFit)
    return found


def _estimates(fit: BogieFit, row: int) -> CurveEstimates:
    curve = curve_replicates(fit, row, EDGES, ParameterUncertainty.of(CLASS), 0.05e-3, RUNS)
    return curve_estimates(curve, CurveParameters(amplitudes=tuple(AMPLITUDES)))


@pytest.mark.slow
@pytest.mark.parametrize("row", [0, 1])
def test_conicities_of_both_wheelsets_are_within_their_intervals(row: int) -> None:
    for found, true in zip(_estimates(_fitted(1), row).conicity, true_conicity(row), strict=True):
        if found.value is None:
            assert row == 1  # a trailing wheelset has not been so far out
            continue
        assert found.low is not None
        assert found.high is not None
        assert found.low <= true <= found.high
        assert abs(found.value - true) < 0.02
        assert found.high - found.low < 0.08  # a wheelset alone has 0.15


@pytest.mark.slow
def test_springs_and_friction_are_found() -> None:
    fit = _fitted(1)
    ratio, std = fit.stiffness_ratio
    assert abs(ratio - 1.0) < 3 * std < 0.25
    assert fit.inverse_friction[0] < 1.0  # of linear creep: 3.3 are expected beforehand
    assert fit.likeness.min() > 0.97


@pytest.mark.slow
def test_a_spring_that_is_not_as_on_file_is_found() -> None:
    stiffer = replace(CLASS.parameters, yaw_stiffness=1.1 * COACH)
    found = fit_bogie(Beforehand.of(replace(CLASS, parameters=stiffer)), runs(RUNS, 1))
    assert isinstance(found, BogieFit)
    assert found.stiffness_ratio[0] == pytest.approx(_fitted(1).stiffness_ratio[0] / 1.1, abs=0.03)


@pytest.mark.slow
def test_runs_are_placed_where_they_were() -> None:
    moved = [(group, placed(run, 0.2)) for group, run in runs(RUNS, 1)]
    found = fit_bogie(Beforehand.of(CLASS), moved)
    assert isinstance(found, BogieFit)
    for row in range(2):
        ours, right = (_estimates(fit, row).conicity[0].value for fit in (found, _fitted(1)))
        assert ours == pytest.approx(right, abs=0.006)
    assert found.stiffness_ratio[0] == pytest.approx(_fitted(1).stiffness_ratio[0], abs=0.03)


def test_what_positions_leave_open_together_is_known_to_a_tenth_of_a_metre() -> None:
    stds = Beforehand.of(CLASS).stds
    assert stds[PARAMETERS.index("shift")] == 0.1
    slope = Curves.straight(0.2).slope(np.array([[-1e-3, 2e-3], [0.1e-3, 20e-3]]))
    assert np.allclose(slope, 0.4)


def test_how_far_a_run_is_off_is_seen_in_the_motion_of_the_wheelsets() -> None:
    ((_, run),) = runs(1, 1, noise=0.0)
    x, way = np.stack([run.relative, run.relative])[0], run.run
    behind = np.stack([np.interp(way - 0.1, way, row) for row in run.lateral[0]])
    assert followed(run, x, behind).shift == pytest.approx(0.1, rel=0.02)
    back = placed(placed(run, 0.1), -0.1)
    assert np.allclose(back.ahead[:, 500:-500], run.ahead[:, 500:-500], atol=2e-5)
    further = placed(run, 0.1)
    assert np.allclose(further.relative, run.relative - (further.track - run.track), atol=1e-12)


def test_what_is_found_of_friction_is_doubted() -> None:
    fit = _fit_like(by_parameter=_friction_alone(1.0))
    assert fit.inverse_friction[1] == pytest.approx(1.0, rel=0.01)
    assert BOGIE.friction_doubt == 1.0
    assert fit.stiffness_ratio[1] == pytest.approx(0.06), "saturated creep is taken for soft creep"


def test_what_saturation_takes_is_doubted_by_a_seventh() -> None:
    """Another law of creep moves the curves as another friction does, while the springs stay as they are."""
    u = UNKNOWNS + 2 * len(nodes())
    whole, friction = np.eye(u), PARAMETERS.index("inverse_friction")
    whole[UNKNOWNS:, friction] = whole[friction, UNKNOWNS:] = np.tile(1e-5 * nodes(), 2)
    change = _by_law(whole)
    assert np.allclose(change[UNKNOWNS:], 0.15 * 3.3 * np.tile(1e-5 * nodes(), 2))
    assert not change[:UNKNOWNS].any()
    by_law = np.concatenate([np.zeros(UNKNOWNS), 0.02 * Curves.straight(0.2).values.ravel()])
    plain, doubted = (
        curve_estimates(
            curve_replicates(fit, 0, EDGES, ParameterUncertainty(), 0.0, 8), CurveParameters(amplitudes=(2e-3,))
        ).conicity[0].std
        for fit in (_fit_like(), _fit_like(by_law=by_law))
    )  # fmt: skip
    assert plain is not None
    assert doubted == pytest.approx(np.hypot(plain, 0.02 * 0.2), rel=0.02)


def _friction_alone(std: float) -> np.ndarray:
    found = np.zeros((UNKNOWNS, UNKNOWNS + 2 * len(nodes())))
    found[2, 2] = std
    return found


def test_few_runs_are_refused() -> None:
    few = fit_bogie(Beforehand.of(CLASS), runs(BOGIE.fewest_groups, 1)[: BOGIE.fewest_groups - 1])
    assert isinstance(few, Reason)
    assert few.code is ReasonCode.TOO_FEW_BLOCKS


def test_runs_over_another_track_are_refused_with_their_cause() -> None:
    found = fit_bogie(Beforehand.of(CLASS), runs(BOGIE.fewest_groups, 1, mirrored=True))
    assert isinstance(found, Reason)
    assert found.code is ReasonCode.MOTION_UNEXPLAINED


def test_bogies_whose_spring_carries_most_of_the_moment_are_estimated_as_one() -> None:
    assert held_by_spring(of_bogie(COACH))
    assert not held_by_spring(of_bogie(SOFT))
    assert not held_by_spring(single(COACH))
    p = CLASS.parameters
    rolling = 2.0 * p.half_contact_distance**2 * p.longitudinal_creep_coefficient * 2.0 * np.pi / 15.0
    assert held_by_spring(of_bogie(4.1 * rolling))  # from 0.8 of both on
    assert not held_by_spring(of_bogie(3.9 * rolling))


def test_curves_between_the_centres_of_bins_keep_their_values() -> None:
    x = nodes()
    values = 0.3 * x + 50.0 * np.abs(x - 0.4e-3) * 1e-3
    shape = in_bins(values[None])[0]
    value, slope, curvature = shape.T
    middle = slice(1, -1)
    assert np.array_equal(value, values)
    assert np.allclose((value + slope / 2 + curvature / 4)[middle], 0.5 * (values[1:-1] + values[2:]), atol=1e-12)
    assert np.allclose((value - slope / 2 + curvature / 4)[middle], 0.5 * (values[1:-1] + values[:-2]), atol=1e-12)


def _fit_like(**changed: object) -> BogieFit:
    b, u = len(nodes()), UNKNOWNS + 2 * len(nodes())
    theta = np.concatenate([np.zeros(UNKNOWNS), Curves.straight(0.2).values.ravel()])
    visited = np.tile(np.where(np.abs(nodes()) < 3.1e-3, 100.0, 0.0), (2, 1))
    base = BogieFit(
        theta, np.tile(theta, (8, 1)), np.zeros((UNKNOWNS, u)), np.zeros(u), 1e-16 * np.eye(u),
        Beforehand.of(CLASS).gear, visited, np.ones(2), np.zeros(2), 0.0,
    )  # fmt: skip
    assert b == visited.shape[1]
    return replace(base, **changed)


def test_a_node_that_was_hardly_run_at_is_not_published() -> None:
    least = BOGIE.least_visited
    visited = np.tile(np.where(np.abs(nodes()) < 3.1e-3, 100.0, 0.0), (2, 1))
    visited[0, np.abs(nodes()) > 2.1e-3] = 0.999 * 40.0
    curve = curve_replicates(_fit_like(visited=visited), 0, EDGES, ParameterUncertainty(), 0.0, 8)
    assert least == 40.0
    assert curve.usable.sum() == np.count_nonzero(np.abs(nodes()) < 2.1e-3)


def test_what_is_simulated_of_the_displacement_widens_and_stretches() -> None:
    plain, open_too = (
        curve_replicates(_fit_like(open_std=np.full(2, std)), 0, EDGES, ParameterUncertainty(), 0.0, 8)
        for std in (0.0, 0.3e-3)
    )
    assert plain.error.excess == 0.0
    assert open_too.error.excess > 0.02
    assert open_too.error.std == pytest.approx(0.3e-3)
    still = curve_replicates(_fit_like(), 0, EDGES, ParameterUncertainty(), 0.3e-3, 8)
    assert still.error.excess == 0.0  # the noise of sensors does not


def test_what_is_known_beforehand_is_that_of_the_class() -> None:
    known = dict(zip(("k", "ky", "friction"), Beforehand.of(CLASS).stds, strict=False))
    assert known == {"k": CLASS.std_of("yaw_stiffness"), "ky": CLASS.std_of("lateral_stiffness"), "friction": 1.2}
    assert Beforehand.of(CLASS).gear.inverse_friction == 3.3


def test_a_bogie_that_does_not_move_as_its_class_is_not_published_and_one_that_ran_too_little_is() -> None:
    moves_otherwise, ran_too_little = (
        FittedBogie(Reason(code, ""), 0, 8, 0.0).against(CLASS)
        for code in (ReasonCode.MOTION_UNEXPLAINED, ReasonCode.TOO_FEW_BLOCKS)
    )
    assert moves_otherwise is not None
    assert ran_too_little is not None
    assert moves_otherwise.certain
    assert not ran_too_little.certain


def test_springs_over_creep_that_no_bogie_of_its_class_has_are_doubted_then_refused() -> None:
    class_std = np.hypot(CLASS.std_of("yaw_stiffness"), CLASS.std_of("longitudinal_creep_coefficient"))
    both = np.hypot(class_std, 0.06)
    for stds, certain in ((1.95, None), (2.05, False), (3.95, False), (4.05, True)):
        theta = _fit_like().theta.copy()
        theta[PARAMETERS.index("yaw_stiffness")] = stds * both
        said = FittedBogie(_fit_like(theta=theta, without=np.tile(theta, (8, 1))), 0, 8, 0.0).against(CLASS)
        assert (None if said is None else said.certain) is certain
        if said is not None:
            assert said.relative == pytest.approx(0.2 * stds * both)
            assert said.reason.code is ReasonCode.YAW_SPRING_DIFFERS
