"""What a profile file leaves open: gauge side, origin, which way is up; and files that are no profile."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.errors import ProfileError
from estimation.values.arrays import FloatArray
from ingest.profiles.files import read_measured_profile, read_profile
from ingest.profiles.orientation import lean
from ingest.profiles.points import Origin

S1002, RAIL = wheel_profile("S1002"), rail_profile("60E1")


def leaning_rail(inclination: float = 1 / 40) -> FloatArray:
    """Return points (n, 2) of 60E1 in track axes, mm, its gauge side negative, sides 30 mm down."""
    y, z = RAIL.y * 1e3, RAIL.z * 1e3
    down = np.arange(0.5, 9.0, 0.5)
    y = np.concatenate([y[0] - down[::-1] / 20.0, y, y[-1] + down / 20.0])
    z = np.concatenate([z[0] + down[::-1], z, z[-1] + down])
    angle = np.arctan(inclination)
    return np.column_stack([y * np.cos(angle) + z * np.sin(angle), z * np.cos(angle) - y * np.sin(angle)])


def rows(points: FloatArray) -> str:
    return "".join(f"{y:.6f} {z:.6f}\n" for y, z in points)


def simpack(points: FloatArray, keywords: str = "") -> str:
    return f"spline.begin\nunits.len.f = 1000\n{keywords}point.begin\n{rows(points)}point.end\nspline.end\n"


def test_the_same_leaning_rail_is_the_same_however_it_is_given(tmp_path: Path) -> None:
    points = leaning_rail()
    mirrored = points[::-1] * [-1.0, 1.0]
    files = {
        "a.prr": simpack(points),
        "b.prr": simpack(mirrored),
        "c.ban": "ColumnDef=X,Y\n\n" + rows(mirrored),
        "d.ban": "ColumnDef=X,Y\n\n" + rows(points * [1.0, -1.0]),
        "e.txt": rows(points),
    }
    radii = []
    for name, text in files.items():
        (tmp_path / name).write_text(text)
        rail = read_profile(tmp_path / name, "rail")
        assert lean(rail.y * 1e3, rail.z * 1e3) == pytest.approx(1 / 40, abs=2e-4)
        table = contact_table(WheelsetOnTrack.symmetric(S1002, rail, 0.0, 1.435), [-3e-3, 3e-3])
        radii.append(table.rolling_radius_left[:, 0])
    np.testing.assert_allclose(radii, np.tile(radii[0], (5, 1)), atol=2e-7)
    inclined = contact_table(WheelsetOnTrack.symmetric(S1002, RAIL, 1 / 40, 1.435), [-3e-3, 3e-3])
    np.testing.assert_allclose(radii[0], inclined.rolling_radius_left[:, 0], atol=2e-6)


def worn_upright_rail() -> FloatArray:
    points = leaning_rail(0.0)
    side = np.clip((points[:, 0] - 20.0) / 16.0, 0.0, 1.0)
    return points - np.column_stack([1.5 * side, np.zeros(len(points))])


def test_a_worn_upright_rail_does_not_show_its_gauge_side_and_mirror_says_it(tmp_path: Path) -> None:
    file = tmp_path / "worn.ban"
    file.write_text("ColumnDef=X,Y\n\n" + rows(worn_upright_rail()))
    with pytest.raises(ProfileError, match="--no-mirror") as caught:
        read_profile(file, "rail")
    assert caught.value.field == "mirror"
    kept, turned = (read_profile(file, "rail", mirror=mirror) for mirror in (False, True))
    np.testing.assert_allclose(turned.height(-kept.y), kept.z, atol=1e-9)
    file = tmp_path / "worn.prr"  # the format fixes it
    file.write_text(simpack(worn_upright_rail()))
    np.testing.assert_allclose(read_profile(file, "rail").z, kept.z, atol=1e-9)


def test_of_a_rail_that_ends_early_the_side_that_is_followed_deeper_is_the_gauge_side(tmp_path: Path) -> None:
    points = leaning_rail(0.0)
    crown = int(np.argmin(points[:, 1]))
    keep = (points[:, 1] < 8.0) & ((np.arange(len(points)) > crown) | (points[:, 1] < 3.0))
    file = tmp_path / "low.ban"
    file.write_text("ColumnDef=X,Y\n\n" + rows(points[keep]))
    rail = read_profile(file, "rail")
    assert rail.z[0] == pytest.approx(8e-3, abs=0.2e-3)
    assert rail.z[-1] == pytest.approx(3e-3, abs=0.2e-3)


def wheel_points(shift: float) -> FloatArray:
    y = np.linspace(-69.3, 59.0, 900)
    return np.column_stack([y + shift, S1002.height(y * 1e-3) * 1e3])


@pytest.mark.parametrize("name", ["w.prw", "w.csv"])
def test_y_from_the_flange_back_or_from_the_datum(tmp_path: Path, name: str) -> None:
    y = np.linspace(-0.06, 0.055, 300)
    file = tmp_path / name
    for shift, origins in ((70.0, (Origin.AUTO, Origin.FLANGE_BACK)), (0.0, (Origin.AUTO, Origin.DATUM))):
        text = simpack(wheel_points(shift)) if name.endswith("prw") else rows(wheel_points(shift))
        file.write_text(text)
        for origin in origins:
            np.testing.assert_allclose(read_profile(file, "wheel", origin=origin).height(y), S1002.height(y), atol=1e-6)
    with pytest.raises(ProfileError, match="tread datum"):
        read_profile(file, "wheel", origin=Origin.FLANGE_BACK)


def flat(slope: float = 0.0) -> str:
    y = np.linspace(50.0, -50.0, 101)
    return simpack(np.column_stack([y, slope * y]))


GUARD = np.concatenate([leaning_rail(0.0), leaning_rail(0.0) + np.array([120.0, 0.0])])
GROOVE = np.insert(GUARD, len(GUARD) // 2, np.column_stack([np.linspace(38, 82, 12), np.full(12, 40.0)]), axis=0)


@pytest.mark.parametrize(
    ("name", "kind", "text", "words", "field"),
    [
        ("flat.prw", "wheel", flat(), "no flange", "z"),
        ("cone.prw", "wheel", flat(0.20271), "no flange", "z"),
        ("leaning.prr", "rail", flat(0.20271), "cannot be a rail head", "z"),
        ("flat.prr", "rail", flat(), "cannot be a rail head", "z"),
        ("narrow.txt", "rail", "0 1\n1 0\n2 0\n3 0\n4 1\n", "is it in another unit", "y"),
        ("metres.txt", "rail", rows(leaning_rail() * 1e-3), "look like metres", "y"),
        ("cross.slcs", "rail", "1 2\n", "give the profile file of one slice", None),
        ("wing.slcw", "wheel", "1 2\n", "give the profile file of one slice", None),
        ("smooth.prr", "rail", simpack(leaning_rail(), "approx.smooth = 0.5\n"), "set it to 0", "approx.smooth"),
        ("guard.txt", "rail", rows(GROOVE), "two heads with a groove", "y"),
    ],
)
def test_what_cannot_be_is_refused_with_a_sentence(
    tmp_path: Path, name: str, kind: str, text: str, words: str, field: str | None
) -> None:
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(ProfileError) as caught:
        read_profile(file, "wheel" if kind == "wheel" else "rail")
    assert words in str(caught.value)
    assert (caught.value.file, caught.value.field) == (str(file), field)


def stepped(profile: Profile, size: float, seed: int = 0) -> FloatArray:
    y = np.linspace(-69.3, 59.0, 900)
    z = profile.height(y * 1e-3) * 1e3 + np.random.default_rng(seed).normal(0.0, 0.01, 900)
    return np.column_stack([y, z + size * (y > 5.0)])


def test_a_step_on_the_tread_is_refused_with_its_line_and_size(tmp_path: Path) -> None:
    file = tmp_path / "wheel.txt"
    file.write_text(rows(stepped(S1002, 0.4)))
    with pytest.raises(ProfileError, match=r"a step of 0\.(39|4\d) mm at y = (5\.\d|4\.9) mm") as caught:
        read_profile(file, "wheel")
    assert caught.value.line == pytest.approx(522, abs=2)
    for size, wheel in ((0.05, S1002), (0.0, wheel_profile("EN15302-H"))):
        file.write_text(rows(stepped(wheel, size)))
        assert read_measured_profile(file, "wheel").noise_std > 5e-6


def test_a_noise_that_is_none_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "wheel.txt"
    file.write_text(rows(wheel_points(0.0)))
    with pytest.raises(ProfileError, match="no standard deviation"):
        read_profile(file, "wheel", noise_std=-1e-6)


def test_a_worn_gauge_face_is_no_lean(tmp_path: Path) -> None:
    """Seen from its sides alone a face worn down to 30 mm leans the other way."""
    points = leaning_rail(0.0)
    worn = points[:, 0] < -25.0
    points[worn, 0] -= np.maximum(points[worn, 1] - 8.0, 0.0) * 0.13
    file = tmp_path / "worn.ban"
    file.write_text("ColumnDef=X,Y\n\n" + rows(points))
    with pytest.raises(ProfileError, match="--no-mirror"):
        read_profile(file, "rail")
    assert np.isnan(lean(points[:, 0], points[:, 1]))


def test_rows_that_repeat_the_one_before_count_once(tmp_path: Path) -> None:
    once, thrice = tmp_path / "once.txt", tmp_path / "thrice.txt"
    points = stepped(S1002, 0.0)
    once.write_text(rows(points))
    thrice.write_text(rows(np.repeat(points, 3, axis=0)))
    np.testing.assert_array_equal(read_profile(thrice, "wheel").z, read_profile(once, "wheel").z)
