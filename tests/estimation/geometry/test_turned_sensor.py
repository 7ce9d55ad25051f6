"""A yaw sensor that is turned about the lateral axis, on track that rolls: in a stiff bogie it looks like conicity."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import bogie_run
import numpy as np
import pytest
from bogie_run import COACH, joined, of_bogie
from smooth_wheelset import alignment, track

from estimation.geometry.estimate import GeometryParameters, estimate_geometry
from estimation.geometry.model_fit import model_fit
from estimation.geometry.uncertainty import ParameterUncertainty
from estimation.tables.bin_table import bin_parameters, cells_of_window, merge_all
from estimation.values.arrays import FloatArray
from estimation.values.geometry import FilledCells, WheelsetGeometry
from estimation.values.windows import Window

ANGLE, RADIUS = np.radians(2.0), 0.45
WAVES = ((0.5e-3, 9.0), (0.7e-3, 14.0), (0.9e-3, 23.0))  # rad and m: 2 mm of cross level
MIDDLE = slice(3, 9)  # of the amplitudes: 1.5 to 2.75 mm


def turned(window: Window, angle: float, *, rolling: bool = True) -> Window:
    """Return what a node measures that is turned by ``angle``, on track that rolls, which moves the axle aside."""
    roll, lateral = np.asarray(window.roll_acceleration), np.asarray(window.lateral_acceleration)
    if rolling:
        for size, wavelength in WAVES:
            wavenumber = 2.0 * np.pi / wavelength
            of_track = -size * (wavenumber * window.speed) ** 2 * np.sin(wavenumber * window.distance)
            roll, lateral = roll + of_track, lateral - RADIUS * of_track
    cos, sin = np.cos(angle), np.sin(angle)
    yaw = np.asarray(window.yaw_acceleration)
    return replace(
        window,
        lateral_acceleration=lateral,
        roll_acceleration=cos * roll - sin * yaw,
        yaw_acceleration=cos * yaw + sin * roll,
    )


@cache
def found(angle: float, *, rolling: bool = True, std: float | None = None) -> WheelsetGeometry:
    assumed = bogie_run.parameters(of_bogie(COACH))
    bins = bin_parameters(assumed)
    tables = []
    for window in joined(COACH, 1):
        table = cells_of_window(turned(window, angle, rolling=rolling), alignment(track(1)), assumed)
        assert isinstance(table, FilledCells), table
        tables.append(table)
    usual = ParameterUncertainty()
    *scales, angle_std = usual.of_bogie
    known = replace(usual, of_bogie=(*scales, angle_std if std is None else std))
    return estimate_geometry(merge_all(tables, bins), bins, GeometryParameters(uncertainty=known))


def conicity(geometry: WheelsetGeometry) -> FloatArray:
    return np.array([np.nan if one.value is None else one.value for one in geometry.conicity])[MIDDLE]


def std(geometry: WheelsetGeometry) -> FloatArray:
    return np.array([one.std for one in geometry.conicity], dtype=np.float64)[MIDDLE]


def shift(std: float | None) -> FloatArray:
    return np.abs(conicity(found(ANGLE, std=std)) - conicity(found(0.0, std=std)))


def test_the_angle_is_taken_out_where_the_track_rolls() -> None:
    taken_out, as_it_is = shift(None), shift(1e-6)
    assert as_it_is.min() > 0.007
    assert (taken_out < 0.3 * as_it_is).all(), "two minutes outweigh most of what is known beforehand"
    assert (shift(0.1) < 0.2 * as_it_is).all(), "nothing known beforehand"


def test_what_is_not_known_of_the_angle_is_in_the_interval() -> None:
    def of_angle(*, rolling: bool) -> FloatArray:
        known, open_ = (std(found(0.0, rolling=rolling, std=value)) for value in (1e-6, None))
        return np.sqrt(np.maximum(open_**2 - known**2, 0.0))

    assert (of_angle(rolling=False) > 0.0115).all()
    assert (of_angle(rolling=True) < 0.65 * of_angle(rolling=False)).all()
    assert (shift(None) < of_angle(rolling=True)).all()


def test_the_spring_error_is_that_of_sensors_that_are_not_turned() -> None:
    """Whatever is known of the angle; the misfit is that with the angle taken out."""
    assumed = bogie_run.parameters(of_bogie(COACH))
    bins = bin_parameters(assumed)
    track_of_run = alignment(track(1))
    tables = [cells_of_window(turned(window, ANGLE), track_of_run, assumed) for window in joined(COACH, 1)]
    merged = merge_all([table for table in tables if isinstance(table, FilledCells)], bins)
    fits = [model_fit(merged, bins, std, uncertainty=ParameterUncertainty()) for std in (1e-6, 0.1)]
    assert fits[0] is not None
    assert fits[1] is not None
    assert fits[0].spring_error == pytest.approx(fits[1].spring_error, abs=1e-6)
    assert fits[1].misfit < fits[0].misfit or fits[0].misfit == 0.0
