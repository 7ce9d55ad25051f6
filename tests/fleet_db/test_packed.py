"""Packed values come back bit for bit, and damage is noticed."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
import stored_values as make
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from estimation.errors import StorageError
from estimation.values.arrays import FloatArray
from estimation.values.geometry import BinTable
from estimation.values.quantities import Estimate, Forecast, Status
from estimation.values.reasons import Reason, ReasonCode
from estimation.values.track import AlignmentSource, GaugeShift, TrackFindings
from estimation.values.trend import WearTrend
from fleet_db.fields import fields_of, from_json, pack, to_json, unpack, value_of
from fleet_db.packed_values import (
    pack_alignment,
    pack_bin_table,
    pack_geometry,
    pack_value,
    pack_wheel_pair,
    unpack_alignment,
    unpack_bin_table,
    unpack_geometry,
    unpack_value,
    unpack_wheel_pair,
)

ANY_FLOAT = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True)
DTYPES = st.sampled_from([np.dtype("<f8"), np.dtype("<i8"), np.dtype("<i2"), np.dtype("u1")])


@given(DTYPES.flatmap(lambda dtype: hnp.arrays(dtype, hnp.array_shapes(min_dims=1, max_dims=3, min_side=0))))
def test_any_array_comes_back_with_the_same_bits(array: FloatArray) -> None:
    blob = pack("k", {"a": [1, None, "x"]}, {"first": array, "second": array})
    scalars, arrays = unpack(blob, "k", where="here")
    assert scalars == {"a": [1, None, "x"]}
    for name in ("first", "second"):
        assert make.same(arrays[name], array)
        assert not arrays[name].flags.writeable


@given(st.one_of(st.none(), st.integers(-(2**63), 2**63), ANY_FLOAT))
def test_any_number_comes_back_exactly(number: float | None) -> None:
    found = from_json(to_json(number), float | None)
    assert type(found) is type(number)
    assert make.same(found, number)


REASONS = st.one_of(st.none(), st.builds(Reason, st.sampled_from(ReasonCode), st.text()))


@given(*[st.one_of(st.none(), ANY_FLOAT)] * 4, ANY_FLOAT, st.sampled_from(Status), REASONS)
def test_any_estimate_comes_back_exactly(
    value: float | None,
    std: float | None,
    low: float | None,
    high: float | None,
    count: float,
    status: Status,
    reason: Reason | None,
) -> None:
    estimate = Estimate(value, std, low, high, count, status, reason)
    assert make.same(from_json(to_json(estimate), Estimate), estimate)


@given(*[st.one_of(st.none(), ANY_FLOAT, st.integers())] * 3)
def test_any_forecast_comes_back_exactly(p10: float | None, p50: float | None, p90: float | None) -> None:
    assert make.same(from_json(to_json(Forecast(p10, p50, p90)), Forecast), Forecast(p10, p50, p90))


@given(st.data(), st.integers(0, 6), st.integers(1, 12))
def test_any_bin_table_comes_back_exactly(data: st.DataObject, groups: int, bins: int) -> None:
    def draw(*shape: int) -> FloatArray:
        return data.draw(hnp.arrays(np.float64, shape, elements=ANY_FLOAT, fill=st.just(0.0)))

    table = BinTable(
        "key", draw(bins + 1), draw(groups, bins), draw(groups, bins, 15), draw(groups, bins, 15), 2**40, 3
    )
    assert make.same(unpack_bin_table(pack_bin_table(table), where="here"), table)


def test_only_filled_cells_take_space() -> None:
    full = make.bin_table(1, 10, 33)
    weight, lateral, yaw = (np.zeros_like(array) for array in (full.weight, full.lateral, full.yaw))
    weight[3, 4], lateral[3, 4], yaw[3, 4] = 7.5, 1.5, 2.5
    sparse = BinTable("key", full.edges, weight, lateral, yaw, 10, 1)
    assert make.same(unpack_bin_table(pack_bin_table(sparse), where="here"), sparse)
    assert len(pack_bin_table(sparse)) < 1000 < len(pack_bin_table(full)) / 10


@pytest.mark.parametrize("seed", range(5))
def test_geometry_trend_and_alignment_come_back_exactly(seed: int) -> None:
    geometry, trend, alignment = make.geometry(seed), make.trend(seed), make.alignment(seed)
    assert make.same(unpack_geometry(pack_geometry(geometry), where="here"), geometry)
    assert make.same(unpack_value(WearTrend, pack_value(trend), where="here"), trend)
    assert make.same(unpack_alignment(pack_alignment(alignment), 0, where="here"), alignment)


def gauge_shifts(wheelsets: int) -> dict[str, GaugeShift]:
    """Return a gauge shift of each of some wheelsets."""
    difference, gauge = np.linspace(-1.0, 1.0, 5), np.linspace(-0.2, 0.2, 3)
    return {f"W{k}": GaugeShift((k + 1) * difference, gauge, np.outer(difference**k, gauge)) for k in range(wheelsets)}


@pytest.mark.parametrize("wheelsets", [0, 3])
def test_what_the_passes_of_a_section_found_comes_back_exactly(wheelsets: int) -> None:
    shifts = gauge_shifts(wheelsets)
    found = TrackFindings({"V1": 1.01, "V2": 0.93}, 0.004, shifts)
    alignment = replace(
        make.alignment(1),
        source=AlignmentSource.FLEET,
        cutoff_wavelength=120.0,
        scale_std=0.01,
        gauge_known=False,
        findings=found,
    )
    back = unpack_alignment(pack_alignment(alignment), 0, where="here")
    assert back.findings is not None
    assert back.findings.stiffness_ratio == found.stiffness_ratio
    assert back.findings.stiffness_ratio_std == found.stiffness_ratio_std
    assert back.cutoff_wavelength == 120.0
    assert back.findings.gauge_shifts.keys() == shifts.keys()
    for name, one in shifts.items():
        assert make.same(back.findings.gauge_shifts[name], one)


def test_a_wheel_pair_comes_back_exactly() -> None:
    pair = (make.wheel("left", 1), make.wheel("right", 2))
    assert make.same(unpack_wheel_pair(pack_wheel_pair(*pair), where="here"), pair)


def test_a_date_keeps_its_last_nanosecond() -> None:
    trend = unpack_value(WearTrend, pack_value(make.trend()), where="here")
    assert trend.date_of_limit_ns.p10 == make.START + 1
    assert float(make.START + 1) != make.START + 1  # a float64 would not have


def test_what_does_not_fit_its_type_is_refused() -> None:
    scalars, arrays = fields_of(make.trend(1))
    with pytest.raises(StorageError, match="a packed number is None"):
        value_of(WearTrend, scalars | {"limit": None}, arrays)
    for wrong in ({name: scalars[name] for name in scalars if name != "reason"}, scalars | {"fitted": [None]}):
        with pytest.raises(StorageError, match="a packed WearTrend does not fit"):
            value_of(WearTrend, wrong, arrays)
    with pytest.raises(TypeError, match="object has no place"):
        to_json(object())


@given(st.data())
def test_a_damaged_blob_is_noticed(data: st.DataObject) -> None:
    blob = pack_bin_table(make.bin_table())
    at = data.draw(st.integers(0, len(blob) - 1))
    flipped = blob[:at] + bytes([blob[at] ^ data.draw(st.integers(1, 255))]) + blob[at + 1 :]
    for damaged in (flipped, blob[:at]):
        try:
            found = unpack_bin_table(damaged, where="the place")
        except StorageError as error:
            assert "the place" in str(error)  # noqa: PT017 - a flip in a reserved bit of the frame may do no harm
        else:
            assert make.same(found, make.bin_table())


def test_a_blob_of_another_kind_is_refused() -> None:
    with pytest.raises(StorageError, match="holds 'bin_table', expected 'WearTrend'"):
        unpack_value(WearTrend, pack_bin_table(make.bin_table()), where="here")


def test_a_blob_that_would_unfold_without_end_is_refused() -> None:
    bomb = b"TWPK\x01" + struct.pack("<IBQ", 0xFD2FB528, 0xE0, 2**40)
    with pytest.raises(StorageError, match="claims to unfold to"):
        unpack(bomb, "k", where="here")


def test_nan_has_no_place_among_the_scalars() -> None:
    with pytest.raises(ValueError, match="JSON"):
        pack("k", {"a": float("nan")}, {})
