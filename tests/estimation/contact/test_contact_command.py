"""The contact command: its formats, its keys, its errors."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner, Result

from api.commands.studies import contact
from estimation.contact.profiles import rail_profile, wheel_profile

KEYS = [
    "lateral_displacement_mm",
    "rolling_radius_difference_mm",
    "rolling_radius_sum_mm",
    "contact_angle_difference_rad",
    "contact_angle_sum_rad",
    "roll_rad",
]


SUMMARY = [
    "wheel_left",
    "wheel_right",
    "rail",
    "inclination",
    "gauge_mm",
    "method",
    "equivalent_conicity_at_3_mm_1",
    "equivalent_conicity_at_3_mm_std_1",
    "limit_1",
    "limit_speed_km_h",
]


def _run(*arguments: str) -> Result:
    app = typer.Typer()
    app.command("contact")(contact)
    return CliRunner().invoke(app, list(arguments))


def test_json_has_the_agreed_keys_and_the_reference_values() -> None:
    result = _run("--wheel", "EN15302-A", "--rail", "EN15302-A", "--inclination", "0", "--gauge-mm", "1435.16")
    assert result.exit_code == 0
    document = json.loads(result.stdout, parse_constant=pytest.fail)
    assert list(document) == [
        *SUMMARY,
        *KEYS,
        "equivalent_conicity",
        "nonlinearity_parameter",
        "contact_jumps_mm",
        "profiles",
    ]
    assert len({len(document[key]) for key in KEYS}) == 1
    conicity = document["equivalent_conicity"]
    found = dict(zip(conicity["amplitude_mm"], conicity["value"], strict=True))
    assert found[3.0] == pytest.approx(0.188, abs=0.003)
    assert document["nonlinearity_parameter"] == pytest.approx((0.216 - 0.155) / 2, abs=0.002)
    assert set(document["roll_rad"]) == {0.0}


@pytest.mark.parametrize(
    ("wheel", "reference", "at_jumps"),
    [
        ("A", {1.0: 0.125, 2.0: 0.155, 3.0: 0.188, 4.0: 0.216, 5.0: 0.254, 6.0: 0.303}, {}),
        ("B", {1.0: 0.025, 2.0: 0.025, 5.0: 0.281, 6.0: 0.301}, {3.0: 0.0296, 3.1: 0.0787}),
        ("C", {1.0: 0.515, 2.0: 0.365, 3.0: 0.271, 4.0: 0.221, 5.0: 0.191, 6.0: 0.170}, {}),
        ("H", {1.0: 0.025, 2.0: 0.025, 5.0: 0.307, 6.0: 0.284}, {2.5: 0.0304, 2.6: 0.1123}),
        ("I", {1.0: 0.0, 3.0: 0.494, 4.0: 0.488, 5.0: 0.477, 6.0: 0.448}, {1.8: 0.1239, 2.0: 0.316}),
    ],
)
def test_conicity_of_the_standard_at_every_amplitude_and_where_its_end_is_on_a_jump(
    wheel: str, reference: dict[float, float], at_jumps: dict[float, float]
) -> None:
    """Wheel B at 3 mm was 0.058 when a jump was interpolated across 0.1 mm."""
    result = _run("--wheel", f"EN15302-{wheel}", "--rail", "EN15302-A", "--inclination", "0", "--gauge-mm", "1435.16")
    document = json.loads(result.stdout)
    conicity = document["equivalent_conicity"]
    found = dict(zip(conicity["amplitude_mm"], conicity["value"], strict=True))
    assert {a: found[a] for a in reference} == pytest.approx(reference, abs=1e-3)
    assert {a: found[a] for a in at_jumps} == pytest.approx(at_jumps, abs=1e-3)
    jumps = {"B": [2.9977, 6.3893], "H": [2.4984, 6.7032], "I": [1.7243]}.get(wheel, [])
    assert document["contact_jumps_mm"] == pytest.approx([*(-y for y in reversed(jumps)), *jumps], abs=1e-3)


def test_unequal_radii_shift_the_crossing_and_the_rigid_method_rolls() -> None:
    result = _run(
        "--method", "rigid", "--radius-left-mm", "460.5", "--radius-right-mm", "459.5", "--wheel-right", "S1002"
    )
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout)
    middle = len(document["lateral_displacement_mm"]) // 2
    assert document["rolling_radius_difference_mm"][middle] > 0.5
    assert document["roll_rad"][middle] != 0.0
    assert document["rolling_radius_sum_mm"][middle] == pytest.approx(920.0, abs=2.0)


def test_what_does_not_exist_is_null() -> None:
    """Far into a tight gauge the wheels climb off: no contact, and no conicity for amplitudes that reach there."""
    result = _run(
        "--gauge-mm", "1415", "--wheel", "S1002", "--rail", "60E1", "--inclination", "1:40", "--method", "rigid"
    )
    assert result.exit_code == 0, result.stderr
    document = json.loads(result.stdout, parse_constant=pytest.fail)
    middle = len(document["roll_rad"]) // 2
    for key in KEYS[1:]:
        assert document[key][0] is None
        assert document[key][middle] is not None
    assert document["equivalent_conicity"]["value"][-1] is None


def test_csv(tmp_path: Path) -> None:
    out = tmp_path / "contact.csv"
    assert _run("--format", "csv", "--out", str(out)).exit_code == 0
    rows = list(csv.DictReader(io.StringIO(out.read_text())))
    assert list(rows[0]) == [*KEYS, *SUMMARY]
    assert len(rows) == 161
    assert {row["wheel_left"] for row in rows} == {"P8"}
    assert float(rows[100]["rolling_radius_difference_mm"]) == pytest.approx(0.913, abs=0.002)


@pytest.mark.parametrize(("speed", "limit"), [(120.0, 0.40), (240.0, 0.534 - 240.0 / 900.0), (320.0, 0.20)])
def test_wheel_rail_gauge_limit_and_the_conicity_at_3_mm_are_named(speed: float, limit: float) -> None:
    wheels = ("--wheel-left", "P8", "--wheel-right", "S1002", "--rail", "60E1", "--inclination", "1:40")
    document = json.loads(_run(*wheels, "--gauge-mm", "1437", "--speed-km-h", str(speed)).stdout)
    named = [document[key] for key in ("wheel_left", "wheel_right", "rail", "inclination", "gauge_mm")]
    assert named == ["P8", "S1002", "60E1", "1:40", 1437.0]
    assert (document["limit_1"], document["limit_speed_km_h"]) == (pytest.approx(limit), speed)
    curve = document["equivalent_conicity"]
    assert document["equivalent_conicity_at_3_mm_1"] == curve["value"][curve["amplitude_mm"].index(3.0)]


def test_png(tmp_path: Path) -> None:
    out = tmp_path / "contact.png"
    assert _run("--format", "png", "--out", str(out)).exit_code == 0
    assert out.read_bytes().startswith(b"\x89PNG")
    assert out.stat().st_size > 20_000


def test_a_wheel_from_a_file_is_the_wheel(tmp_path: Path) -> None:
    profile = wheel_profile("P8")
    y = np.linspace(-69.0, 58.0, 2001)
    file = tmp_path / "p8.csv"
    file.write_text("".join(f"{a:.6f},{b:.6f}\n" for a, b in zip(y, profile.height(y * 1e-3) * 1e3, strict=True)))
    from_file, by_name = (json.loads(_run("--wheel", wheel).stdout) for wheel in (str(file), "P8"))
    difference = np.array(from_file[KEYS[1]]) - np.array(by_name[KEYS[1]])
    assert np.sqrt(np.mean(difference**2)) < 0.01


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--wheel", "P9"], "known: P8"),
        (["--rail", "nowhere/rail.ban"], "nowhere/rail.ban"),
        (["--rail", "54E2"], "49E1, 49E2"),
        (["--rail", "54E2"], "give any other as a file"),
        (["--inclination", "steep"], "'steep' is no inclination"),
        (["--inclination", "1:0"], "inclination"),
        (["--gauge-mm", "1900"], "never touch"),
        (["--gauge-mm", "-1"], "gauge"),
        (["--flange-back-mm", "nan"], "flange_back_distance"),
        (["--format", "png"], "--out"),
        (["--out", "nowhere/x.json"], "nowhere/x.json"),
        (["--mirror"], "--mirror"),
        (["--origin", "datum"], "none is given"),
        (["--noise-mm", "0.02"], "--noise-mm"),
        (["--wheel", "S1002/h40/e30"], "h = 40"),
    ],
)
def test_bad_input_is_one_clear_line_and_exit_code_2(arguments: list[str], words: str) -> None:
    result = _run(*arguments)
    assert result.exit_code == 2
    assert words in result.stderr
    assert len(result.stderr.strip().splitlines()) == 1
    assert result.stdout == ""


def test_an_unknown_method_or_format_is_refused() -> None:
    assert _run("--method", "guess").exit_code == 2
    assert _run("--format", "xml").exit_code == 2


def _measured(folder: Path, name: str = "wheel.csv") -> Path:
    wheel = wheel_profile("S1002")
    y = np.linspace(-69.0, 58.0, 900)
    z = wheel.height(y * 1e-3) * 1e3 + np.random.default_rng(2).normal(0.0, 0.02, len(y))
    z[700] += 1.0
    file = folder / name
    file.write_text("".join(f"{a + 70.0:.4f},{b:.4f}\n" for a, b in zip(y, z, strict=True)))
    return file


def test_a_measured_wheel_has_a_conicity_with_a_std(tmp_path: Path) -> None:
    file = _measured(tmp_path)
    pair = ("--rail", "60E1", "--inclination", "1:40")
    result = _run("--wheel", str(file), "--origin", "flange-back", *pair)
    assert result.exit_code == 0, result.stderr
    assert "wheel: 1 points far from the profile are left out" in result.stderr
    document = json.loads(result.stdout)
    design = json.loads(_run("--wheel", "EN13715-S1002/h28/e32.5", *pair).stdout)
    assert set(design["equivalent_conicity"]["std"]) == {0.0}
    assert document["profiles"]["rails"] == {"name": "60E1", "noise_mm": 0.0, "points_left_out": 0, "design": None}
    assert document["profiles"]["left_wheel"]["design"] == "EN13715-S1002/h28/e32.5"
    assert document["profiles"]["left_wheel"]["noise_mm"] == pytest.approx(0.016, abs=0.003)
    at = document["equivalent_conicity"]["amplitude_mm"].index(3.0)
    value, std = (document["equivalent_conicity"][key][at] for key in ("value", "std"))
    assert value == pytest.approx(design["equivalent_conicity"]["value"][at], abs=0.01)
    assert 0.0003 < std < 0.01
    raw = json.loads(_run("--wheel", str(file), "--noise-mm", "0", *pair).stdout)
    assert raw["profiles"]["left_wheel"]["noise_mm"] == 0.0


def test_a_rail_that_leans_already_is_noted(tmp_path: Path) -> None:
    rail = rail_profile("60E1")
    y, z = rail.y * 1e3, rail.z * 1e3
    down = np.arange(0.5, 9.0, 0.5)
    y = np.concatenate([y[0] - down[::-1] / 20.0, y, y[-1] + down / 20.0])
    z = np.concatenate([z[0] + down[::-1], z, z[-1] + down])
    file = tmp_path / "rail.txt"
    file.write_text("".join(f"{a + b / 40.0:.6f} {b - a / 40.0:.6f}\n" for a, b in zip(y, z, strict=True)))
    twice, once = (_run("--wheel", "S1002", "--rail", str(file), "--inclination", lean) for lean in ("1:40", "0"))
    assert "rail: leans by 1:40 in its file and is inclined 1:40 besides" in twice.stderr
    assert once.stderr == ""
    mirrored = _run("--wheel", "S1002", "--rail", str(file), "--inclination", "0", "--mirror")
    assert json.loads(mirrored.stdout)[KEYS[1]] != json.loads(once.stdout)[KEYS[1]]


def _wheel_file(folder: Path, *, turn: float = 0.0, step: float = 0.0) -> Path:
    """Write an S1002, turned (rad), with a step of the tread (mm)."""
    wheel = wheel_profile("S1002")
    y = np.linspace(-69.0, 58.0, 900)
    z = wheel.height(y * 1e-3) * 1e3 + np.random.default_rng(3).normal(0.0, 0.01, len(y)) + np.where(y > 5.0, step, 0.0)
    points = np.column_stack([y, z]) @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    file = folder / "wheel.txt"
    file.write_text("".join(f"{a:.5f} {b:.5f}\n" for a, b in points))
    return file


def test_a_wheel_that_is_turned_against_its_design_is_noted(tmp_path: Path) -> None:
    assert "turned by +0.57 degrees" in _run("--wheel", str(_wheel_file(tmp_path, turn=0.01))).stderr
    assert _run("--wheel", str(_wheel_file(tmp_path, turn=0.001))).stderr == ""


def test_flanges_without_play_are_noted() -> None:
    assert "2.4 mm of play" in _run("--wheel", "S1002", "--flange-back-mm", "1365.2").stderr
    assert _run("--wheel", "S1002", "--flange-back-mm", "1364.8").stderr == ""


def test_a_small_step_and_decimal_commas_are_refused(tmp_path: Path) -> None:
    assert "a step of 0.1" in _run("--wheel", str(_wheel_file(tmp_path, step=0.12))).stderr
    file = _wheel_file(tmp_path)
    file.write_text(file.read_text().replace(" ", ";").replace(".", ","))
    assert "write decimal points" in _run("--wheel", str(file)).stderr
