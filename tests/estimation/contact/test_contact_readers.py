"""Profile files in every format and variant, written by the tests themselves, and what is wrong with bad ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import Profile, ProfileKind, rail_profile, wheel_profile
from estimation.contact.smoothed_profile import thinned
from estimation.errors import ProfileError
from ingest.profiles.files import read_measured_profile, read_profile
from ingest.profiles.points import MOST_ROWS

WHEEL, RAIL = wheel_profile("S1002"), rail_profile("60E1")
WHEEL_Y = np.linspace(-69.3, 59.0, 643)
WHEEL_Z = WHEEL.height(WHEEL_Y * 1e-3) * 1e3
RAIL_T = np.linspace(-1.0, 1.0, 601)
RAIL_Y = 36.2 * np.sin(RAIL_T * np.pi / 2)
RAIL_Z = RAIL.height(RAIL_Y * 1e-3) * 1e3


def _rows(*columns: np.ndarray, separator: str = " ") -> str:
    return "".join(separator.join(f"{value:.6f}" for value in row) + "\n" for row in zip(*columns, strict=True))


def _assert_same(found: Profile, truth: Profile, low: float, high: float) -> None:
    y = np.linspace(low, high, 500)
    np.testing.assert_allclose(found.height(y), truth.height(y), atol=3e-6)


@pytest.mark.parametrize(
    "header",
    [
        "ProgramName=MiniProf\nColumnDef=X,Y\nXYPoints=643\nSide=%L\n\n",
        'columndef=Y,X,A\nxypoints=643\n"RefPoint1="\n\n',
        "XYPoints=643\nGauge=1435.2\nColumnDef=X,Y\n",
        "MINIPROF 101 148 1994 3 24\navg.prd\nStock.......:\n32.5 28.0 10.8 (Sd/Sh/qR)\n\n",
        '#MINIWHEELPROF\nwheel(R).whl\nMINIPROF 2020\nWheel ID....:\n" 32.5 28.0 10.8\n(Sd/Sh/qR)\n\n',
    ],
)
@pytest.mark.parametrize("upwards", [False, True])
@pytest.mark.parametrize("reversed_order", [False, True])
def test_miniprof_wheels(tmp_path: Path, header: str, *, upwards: bool, reversed_order: bool) -> None:
    x, z = WHEEL_Y + 70.0, -WHEEL_Z if upwards else WHEEL_Z
    x, z = (x[::-1], z[::-1]) if reversed_order else (x, z)
    columns = (z, x, 0 * x) if header.startswith("columndef=Y,X") else (x, z)
    file = tmp_path / "wheel.whl"
    file.write_text(header + _rows(*columns))
    profile = read_profile(file, "wheel")
    assert profile.kind == "wheel"
    _assert_same(profile, WHEEL, -0.055, 0.055)


def test_a_wheel_given_from_its_outer_end_is_turned_round(tmp_path: Path) -> None:
    file = tmp_path / "wheel.csv"
    file.write_text(_rows(-WHEEL_Y, WHEEL_Z, separator=","))
    _assert_same(read_profile(file, "wheel"), WHEEL, -0.055, 0.055)


@pytest.mark.parametrize("upwards", [False, True])
def test_miniprof_rails_with_rows_taken_out_and_words_after_a_row(tmp_path: Path, *, upwards: bool) -> None:
    z = -RAIL_Z if upwards else RAIL_Z
    rows = _rows(RAIL_Y, z).splitlines()
    rows.insert(300, '"99.0 99.0 % too close')
    rows[200] += " added by hand"
    file = tmp_path / "rail.BAN"
    file.write_text("ColumnDef=X,Y\nXYPoints=602\n\n" + "\n".join(rows) + "\n")
    _assert_same(read_profile(file, "rail"), RAIL, -0.034, 0.034)


def test_miniprof_multipart(tmp_path: Path) -> None:
    file = tmp_path / "rail.mpt"
    points = _rows(RAIL_Y, RAIL_Z, separator=",")
    file.write_text(
        f"[FileInfo]\nParts=2\n[Profile1Info]\nColumnDef=X,Y\n[Profile1Points]\n{points}[Profile2Points]\n1,2\n"
    )
    _assert_same(read_profile(file, "rail"), RAIL, -0.034, 0.034)


def test_only_the_gauge_side_reaches_deep(tmp_path: Path) -> None:
    """A rail measured on its gauge side only is mirrored until that side is negative."""
    keep = RAIL_Y > -25.0
    file = tmp_path / "rail.txt"
    file.write_text(_rows(RAIL_Y[keep], RAIL_Z[keep]))
    profile = read_profile(file, "rail")
    assert profile.y[0] < -0.0359
    assert profile.y[-1] == pytest.approx(0.025, abs=2e-4)
    file.write_text(_rows(RAIL_Y, RAIL_Z + 0.001 * RAIL_Y))
    both, mirrored = read_profile(file, "rail"), read_profile(file, "rail", mirror=True)
    np.testing.assert_allclose(mirrored.height(-both.y), both.z, atol=1e-9)


def test_simpack_applies_its_keywords_in_order(tmp_path: Path) -> None:
    """Shift, then rotation, then bounds, then mirror, then inversion, then units."""
    angle, metres = 0.1, 1e-3
    turned = (WHEEL_Y + 1j * WHEEL_Z) * metres * np.exp(-1j * angle)
    y, z = turned.real - 0.002, turned.imag + 0.001
    file = tmp_path / "wheel.prw"
    file.write_text(
        "! a remark\nheader.begin\n type = 1\nheader.end\nspline.begin\n"
        " shift.y = 0.002 ! first\n shift.z = -1.0e-03\n rotate = 100\n units.ang.f = 1000\n units.len.f = 1\n"
        " bound.y.min = -0.0601\n bound.y.max = 0.0571\n mirror.y = 0\n mirror.z = 0\n inversion = 0\n point.begin\n"
        + _rows_exact(y, z)
        + "!9 9\n point.end\nspline.end\n"
    )
    profile = read_profile(file, "wheel")
    _assert_same(profile, WHEEL, -0.055, 0.055)
    assert profile.y[0] >= -0.0601
    assert profile.y[-1] <= 0.0571


def test_simpack_mirrors_and_inverts(tmp_path: Path) -> None:
    file = tmp_path / "wheel.prw"
    file.write_text(
        "spline.begin\nmirror.y = 1\nmirror.z = 1\ninversion = 1\nunits.len.f = 1000\npoint.dist.min=0.5\npoint.begin\n"
        + _rows(-WHEEL_Y[::-1], -WHEEL_Z[::-1], np.ones_like(WHEEL_Y))
        + "point.end\n"
    )
    profile = read_profile(file, "wheel")
    assert np.hypot(np.diff(profile.y), np.diff(profile.z)).min() > 0.49e-3
    np.testing.assert_allclose(profile.height(WHEEL.y[500:-500]), WHEEL.z[500:-500], atol=3e-5)


@pytest.mark.parametrize("header", ["", "y,z\n", "# a rail\ny_mm;z_mm\n\n", "\ufeffy,z\n"])
def test_two_columns(tmp_path: Path, header: str) -> None:
    file = tmp_path / "rail.csv"
    rows = "".join(f"{a:.9f}, {b:.9f}\n" for a, b in zip(RAIL_Y, RAIL_Z, strict=True))
    file.write_text(header + rows, encoding="utf-8")
    _assert_same(read_profile(file, "rail"), RAIL, -0.034, 0.034)


def test_overhanging_points_are_left_out(tmp_path: Path) -> None:
    under = np.linspace(36.2, 20.0, 30)
    file = tmp_path / "rail.txt"
    y = np.concatenate([-under[::-1], RAIL_Y, under])
    z = np.concatenate([np.linspace(30.0, 20.0, 30), RAIL_Z, np.linspace(20.0, 30.0, 30)])
    file.write_text(_rows(y, z))
    _assert_same(read_profile(file, "rail"), RAIL, -0.034, 0.034)


@pytest.mark.parametrize(
    ("name", "text", "line", "field", "words"),
    [
        ("a.csv", "y,z\n0,0\n1,nan\n2,0\n3,0\n4,1\n", 3, "z", "not a finite number"),
        ("a.csv", "y,z\n0,0\n1,x\n2,0\n3,0\n4,1\n", 3, "z", "'x' is not a number"),
        ("a.csv", "0,0\n1\n2,0\n", 2, None, "1 column"),
        ("a.csv", "0,0\n1,1\n", None, None, "2 profile points"),
        ("a.csv", "", None, None, "0 profile points"),
        ("a.whl", "ColumnDef=X,Y\nXYPoints=5\n\n0 0\n1 inf\n2 0\n", 5, "Y", "not a finite number"),
        ("a.whl", "ColumnDef=X,Y\nXYPoints=50\n\n0 0\n1 1\n2 0\n3 0\n", 2, "XYPoints", "50 points are announced, 4"),
        ("a.whl", "ColumnDef=X,Z\n\n0 0\n", 1, "ColumnDef", "'X,Z'"),
        ("a.whl", "Stock=1\nSide=2\n", None, None, "no points follow"),
        ("a.mpt", "[FileInfo]\n0 0\n", None, None, "Profile1Points"),
        ("a.prr", "point.begin\n0 0\n1 1\n2 2\n3 3\n", None, None, "point.end"),
        ("a.prr", "spline.begin\n", None, None, "point.begin"),
        ("a.prr", "units.len.f=0\npoint.begin\n0 0\n1 1\n2 2\n3 3\npoint.end\n", None, "units.len.f", "zero"),
        ("a.prr", "shift.y=abc\npoint.begin\n0 0\n1 1\n2 2\n3 3\npoint.end\n", 1, "shift.y", "'abc'"),
        ("a.prr", "point.begin\n0 0\n1\n2 2\n3 3\npoint.end\n", 3, None, "1 column"),
    ],
)
def test_bad_files_name_file_line_and_field(
    tmp_path: Path, name: str, text: str, line: int | None, field: str | None, words: str
) -> None:
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(ProfileError) as caught:
        read_profile(file, "rail")
    assert caught.value.file == str(file)
    assert caught.value.line == line
    assert field is None or field in str(caught.value.field)
    assert words in str(caught.value)


def test_points_in_no_order_are_refused(tmp_path: Path) -> None:
    order = np.random.default_rng(3).permutation(len(RAIL_Y))
    file = tmp_path / "rail.txt"
    file.write_text(_rows(RAIL_Y[order], RAIL_Z[order]))
    with pytest.raises(ProfileError, match="not in order") as caught:
        read_profile(file, "rail")
    assert caught.value.line is not None


def test_what_is_no_profile_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ProfileError, match="cannot be read"):
        read_profile(tmp_path / "missing.whl", "wheel")
    binary = tmp_path / "binary.whl"
    binary.write_bytes(b"\x00\x01\x02" * 50)
    with pytest.raises(ProfileError, match="not a text file"):
        read_profile(binary, "wheel")
    short = tmp_path / "short.csv"
    keep = WHEEL_Y < -20.0
    short.write_text(_rows(WHEEL_Y[keep], WHEEL_Z[keep]))
    with pytest.raises(ProfileError, match="tread datum"):
        read_profile(short, "wheel")
    wheel = tmp_path / "wheel.csv"
    wheel.write_text(_rows(WHEEL_Y, WHEEL_Z))
    with pytest.raises(ProfileError, match="flange shows"):
        read_profile(wheel, "wheel", mirror=True)


def _rows_exact(y: np.ndarray, z: np.ndarray) -> str:
    return "".join(f"{a:.15e} {b:.15e}\n" for a, b in zip(y, z, strict=True))


def test_a_wheel_of_many_points_is_read_as_one_of_few(tmp_path: Path) -> None:
    y = np.linspace(-69.3, 59.0, 16_000)
    z = WHEEL.height(y * 1e-3) * 1e3 + 0.02 * np.random.default_rng(1).standard_normal(len(y))
    z[8000] -= 1.0
    file = tmp_path / "wheel.csv"
    file.write_text(_rows(y, z))
    found = read_measured_profile(file, "wheel")
    at = np.linspace(-0.030, 0.055, 500)
    np.testing.assert_allclose(found.profile.height(at), WHEEL.height(at), atol=12e-6)
    assert found.noise_std == pytest.approx(20e-6, rel=0.2)
    assert found.spline is not None
    assert len(found.spline.residual) <= PROFILES.most_points
    file.write_text(_rows(np.roll(y, 7)[::-1], np.roll(z, 7)[::-1]))
    with pytest.raises(ProfileError, match="not in order") as caught:
        read_profile(file, "wheel")
    assert caught.value.field == "y"


def test_points_that_are_thinned_are_evenly_spaced_along_the_arc() -> None:
    """Also where one half was measured ten times as densely: taking every so many rows would not be."""
    y = np.concatenate([np.linspace(0.0, 50.0, 20_000), np.linspace(50.0, 100.0, 2_001)[1:]])
    points = np.column_stack([y, 0.1 * y])
    kept = points[thinned(points)]
    assert 0.9 * PROFILES.most_points * 0.75 < len(kept) <= PROFILES.most_points
    assert np.diff(kept[:, 0]).max() < 0.06
    few = points[: PROFILES.most_points]
    np.testing.assert_array_equal(thinned(few), np.arange(PROFILES.most_points))


@pytest.mark.parametrize("kind", ["wheel", "rail"])
def test_a_track_given_as_a_profile_is_refused(tmp_path: Path, kind: ProfileKind) -> None:
    s = np.arange(16_000) * 0.25
    file = tmp_path / "track.csv"
    file.write_text("s_m,alignment_mm\n" + _rows(s, np.sin(s / 5.0), separator=","))
    with pytest.raises(ProfileError, match=f"spans 4000 mm, and a {kind} at most 500 mm: give a file") as caught:
        read_profile(file, kind)
    assert (caught.value.file, caught.value.field) == (str(file), "y")
    file.write_text(_rows(np.sin(s / 5.0) * 30.0, s, separator=","))
    with pytest.raises(ProfileError, match="spans 4000 mm") as caught:
        read_profile(file, kind)
    assert caught.value.field == "z"


def test_a_file_of_too_many_points_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "many.txt"
    file.write_text("0 0\n" * (MOST_ROWS + 1))
    with pytest.raises(ProfileError, match="50,001 profile points found, at most 50,000") as caught:
        read_profile(file, "wheel")
    assert (caught.value.line, caught.value.field) == (MOST_ROWS + 1, "y")
