"""What the error of a conicity is made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from smooth_wheelset import ideal, run

from estimation.geometry.estimate import YAW_SOURCES, GeometryParameters, estimate_geometry
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.tables.bin_table import BinParameters, tabulate
from estimation.values.error_parts import VARYING, CommonTo, ErrorSource, error_effects, varying_stds
from estimation.values.geometry import WheelsetGeometry, known_conicities
from estimation.values.quantities import parts_of
from estimation.vehicle.regressors import YAW_TARGETS

PARAMETERS = BinParameters(band_limited=True)


@pytest.fixture(scope="module")
def geometry() -> WheelsetGeometry:
    """Return the geometry of four minutes with a vehicle and a displacement that are uncertain."""
    uncertain = ParameterUncertainty(displacement=0.02, scale=0.01, jump_position_std=0.1e-3)
    return estimate_geometry(
        tabulate(ideal(run(240, swing=4.0)), PARAMETERS), PARAMETERS, GeometryParameters(uncertainty=uncertain)
    )


def test_the_parts_make_the_std(geometry: WheelsetGeometry) -> None:
    sampling = geometry.error_sources.index(ErrorSource.SAMPLING)
    shared = np.delete(geometry.error_effects, sampling, axis=0)
    checked = 0
    for place, estimate in enumerate(geometry.conicity):
        if estimate.std is None or estimate.high is None or estimate.value is None:
            continue
        checked += 1
        half = 1.959964 * np.linalg.norm(geometry.error_effects[:, place])
        assert half == pytest.approx(estimate.high - estimate.value, rel=1e-6)
        systematic = float(np.linalg.norm(shared[:, place]))
        assert systematic < estimate.std
        groups = 16
        assert parts_of(estimate, groups)[1] == pytest.approx(systematic, rel=0.02)
    assert checked >= 5


def test_the_noise_of_a_conicity_is_what_differs_from_interval_to_interval(geometry: WheelsetGeometry) -> None:
    rows = dict(zip(geometry.error_sources, geometry.error_effects, strict=True))
    assert known_conicities(geometry)
    for conicity in known_conicities(geometry):
        place = int(np.argmin(np.abs(geometry.amplitude - conicity.amplitude)))
        friction = 0.5 * rows[ErrorSource.FRICTION][place]
        assert conicity.noise == pytest.approx(min(np.hypot(rows[ErrorSource.SAMPLING][place], friction), conicity.std))
    without = replace(geometry, error_sources=(), error_effects=np.zeros((0, 0)))
    assert all(conicity.noise == conicity.std for conicity in known_conicities(without))


def test_a_larger_stretch_is_a_larger_part_and_shows_in_no_noise() -> None:
    def stretched(scale: float) -> WheelsetGeometry:
        uncertain = ParameterUncertainty(displacement=scale)
        table = tabulate(ideal(run(240, swing=4.0)), PARAMETERS)
        return estimate_geometry(table, PARAMETERS, GeometryParameters(uncertainty=uncertain))

    little, much = stretched(0.01), stretched(0.05)
    place = little.error_sources.index(ErrorSource.STRETCH)
    covered = [k for k, estimate in enumerate(much.conicity) if estimate.value is not None]
    assert (np.abs(much.error_effects[place, covered]) > np.abs(little.error_effects[place, covered])).all()
    noises = [
        [conicity.noise for conicity in known_conicities(geometry)][: len(covered)] for geometry in (little, much)
    ]
    np.testing.assert_allclose(*noises, rtol=1e-9)


def test_effects_of_one_source_are_independent_and_have_the_sign_of_the_largest() -> None:
    creep, blur = ErrorSource.CREEP, ErrorSource.BLUR
    sources, effects = error_effects([creep, blur, creep], np.array([[3.0, np.nan], [1.0, 2.0], [-4.0, 1.0]]))
    assert sources == (creep, blur)
    np.testing.assert_allclose(effects, [[-5.0, np.nan], [1.0, 2.0]])


def test_who_errs_alike() -> None:
    assert {source for source in ErrorSource if source.common_to is CommonTo.SECTION} == {
        ErrorSource.ALIGNMENT,
        ErrorSource.STRETCH,
    }
    assert ErrorSource.SAMPLING.common_to is CommonTo.NOTHING
    assert ErrorSource.JUMP_PLACE.common_to is CommonTo.WHEELSET
    assert (VARYING.sampling, VARYING.friction) == (1.0, 0.5)
    every = tuple(ErrorSource)
    assert varying_stds(every, np.array([3e-3]), np.ones((len(every), 1))) == {3e-3: pytest.approx(np.hypot(1.0, 0.5))}


def test_each_target_of_the_yaw_equation_has_its_source() -> None:
    named = dict(zip(YAW_TARGETS[1:], YAW_SOURCES, strict=True))
    assert named["longitudinal_creep"] is ErrorSource.CREEP
    assert named["yaw_stiffness"] is ErrorSource.STIFFNESS
    assert named["saturation"] is ErrorSource.FRICTION
