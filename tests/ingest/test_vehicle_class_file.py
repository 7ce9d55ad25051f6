"""Vehicle class files: what they hold, what they refuse, and where the refusal points."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from in_process_command import Run

from estimation.errors import InputError, NotFoundError
from estimation.vehicle.vehicle_class import Arrangement, VehicleParameters
from ingest.vehicle_class_schema import read_vehicle_class, shipped_class, shipped_classes, shipped_path

UNIT_ERRORS = [  # class, key, factor by which its unit is wrong
    *(
        ("coach", key, factor)
        for key in ("mass_kg", "yaw_inertia_kg_m2", "pitch_inertia_kg_m2")
        for factor in (1e3, 1e-3)
    ),
    *(("coach", key, factor) for key in ("nominal_radius_mm", "half_contact_distance_mm") for factor in (1e3, 1e-3)),
    *(
        (code, key, factor)
        for code in ("coach", "freight")
        for key in (
            "primary_suspension.lateral_stiffness_n_m",
            "primary_suspension.lateral_damping_n_s_m",
            "primary_suspension.yaw_stiffness_n_m_rad",
            "primary_suspension.yaw_damping_n_m_s_rad",
            "secondary_suspension.lateral_stiffness_n_m",
            "secondary_suspension.lateral_damping_n_s_m",
            "secondary_suspension.yaw_stiffness_n_m_rad",
            "wheelbase_m",
            "frame_mass_kg",
            "frame_yaw_inertia_kg_m2",
            "body_mass_kg",
            "rail_head_radius_mm",
        )
        for factor in (1e3, 1e-3)
    ),
    *(("freight", "secondary_suspension.yaw_damping_n_m_s_rad", factor) for factor in (1e3, 1e-3)),
    *(
        ("paper", key, factor)
        for key in ("suspended_mass_kg", "lateral_stiffness_n_m", "yaw_stiffness_n_m_rad", "lateral_damping_n_s_m")
        for factor in (1e3, 1e-3)
    ),
    *(("paper", key, factor) for key in ("longitudinal_n", "lateral_n", "lateral_spin_n_m") for factor in (1e3, 1e-3)),
]


def edited(folder: Path, code: str, old: str, new: str) -> Path:
    text = shipped_path(code).read_text(encoding="utf-8")
    assert old in text
    path = folder / "vehicle.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    return path


def test_that_of_the_paper_holds_the_numbers_of_its_table() -> None:
    vehicle = shipped_class("paper")
    table = VehicleParameters()
    for name in VehicleParameters.__slots__:
        expected = table.axle_load if name == "load" else getattr(table, name)
        assert getattr(vehicle.parameters, name) == expected, name
    assert not vehicle.sensors.measures_gravity
    assert vehicle.arrangement is Arrangement.SINGLE_WHEELSET


def test_the_coach_is_vehicle_1_of_the_manchester_benchmarks() -> None:
    vehicle = shipped_class("coach")
    assert vehicle.bogie is not None
    assert (vehicle.bogie.wheelbase, vehicle.bogie.frame_mass, vehicle.bogie.frame_yaw_inertia) == (2.56, 2615, 3067)
    assert vehicle.parameters.yaw_stiffness == pytest.approx(2 * 31.391e6)
    assert vehicle.parameters.lateral_stiffness == pytest.approx(2 * 3.884e6)
    weight = (32000 / 4 + 2615 / 2 + 1813) * 9.81
    assert vehicle.parameters.load == pytest.approx(weight)
    assert vehicle.sensors.measures_gravity


def test_every_shipped_class_is_read() -> None:
    assert set(shipped_classes()) == {"coach", "freight", "paper", "soft_bogie"}
    for code in shipped_classes():
        assert shipped_class(code).code == code
    with pytest.raises(NotFoundError, match="tram"):
        shipped_class("tram")


def test_a_std_in_the_unit_of_its_value_becomes_relative(tmp_path: Path) -> None:
    path = edited(
        tmp_path, "paper", "yaw_stiffness_n_m_rad = 2.5e6", "yaw_stiffness_n_m_rad = { value = 2.5e6, std = 5e5 }"
    )
    vehicle = read_vehicle_class(path)
    assert vehicle.std_of("yaw_stiffness") == pytest.approx(0.2)
    assert vehicle.std_of("lateral_stiffness") == 0.05


def test_a_std_of_the_rail_head_widens_the_creep_coefficients(tmp_path: Path) -> None:
    sure = read_vehicle_class(
        edited(tmp_path, "coach", "{ value = 300.0, std = 30.0 }", "{ value = 300.0, std = 0.0 }")
    )
    wide = read_vehicle_class(
        edited(tmp_path, "coach", "{ value = 300.0, std = 30.0 }", "{ value = 300.0, std = 90.0 }")
    )
    name = "longitudinal_creep_coefficient"
    assert wide.std_of(name) > 1.03 * sure.std_of(name)
    assert wide.parameters == sure.parameters


@pytest.mark.parametrize(("code", "key", "factor"), UNIT_ERRORS)
def test_a_parameter_in_the_wrong_unit_is_refused_at_its_line(
    tmp_path: Path, code: str, key: str, factor: float
) -> None:
    lines = shipped_path(code).read_text(encoding="utf-8").splitlines()
    table, _, key = key.rpartition(".")
    start = next((at for at, line in enumerate(lines) if line.startswith(f"[{table}]")), 0) if table else 0
    number = next(at for at in range(start, len(lines)) if lines[at].startswith(f"{key} ="))
    value = re.search(r"value = ([\d.e]+)|= ([\d.e]+)", lines[number])
    assert value is not None
    lines[number] = f"{key} = {float(value[1] or value[2]) * factor!r}"
    path = tmp_path / "vehicle.toml"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_vehicle_class(path)
    assert caught.value.line == number + 1, str(caught.value)
    assert key in (caught.value.field or "")


def test_the_mode_that_a_wrong_unit_moves_is_named(tmp_path: Path) -> None:
    path = edited(tmp_path, "coach", "yaw_stiffness_n_m_rad = 62.782e6", "yaw_stiffness_n_m_rad = 62.782e3")
    with pytest.raises(InputError, match=r"the mode 'wheelset yaw on its primary springs' would be 1\.19 Hz"):
        read_vehicle_class(path)


@pytest.mark.parametrize(("stiffness", "factor"), [(7.768e3, "1,000"), (7.768, "1,000,000")])
def test_the_factor_of_a_wrong_unit_is_given(tmp_path: Path, stiffness: float, factor: str) -> None:
    path = edited(tmp_path, "coach", "lateral_stiffness_n_m = 7.768e6", f"lateral_stiffness_n_m = {stiffness}")
    with pytest.raises(InputError, match=f"lateral_stiffness is {factor} times too small"):
        read_vehicle_class(path)


def test_what_is_known_exactly_can_be_checked(treadwatch: Run, tmp_path: Path) -> None:
    path = edited(tmp_path, "coach", "value = 1813.0, std = 20.0", "value = 1813.0, std = 1e-300")
    done = treadwatch("vehicle", "check", path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("content", ["", "\x00", "a = " + 100_000 * "["])
def test_a_file_without_a_class_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        read_vehicle_class(path)
    assert caught.value.file == str(path)


@pytest.mark.parametrize(
    ("old", "new", "field", "reason"),
    [
        ('axis = "z"', 'axis = "y"', "sensors.yaw.axis", "must be 'z'"),
        ('place = "frame"', 'place = "mass"', "sensors.mass_lateral.place", "must be 'frame'"),
        ('place = "frame"', 'place = "axle_box"', "sensors.mass_lateral.place", "is measured at"),
        ("noise_density_rad_s2_rthz", "noise_density_m_s2_rthz", "sensors.yaw.noise_density_rad_s2_rthz", "is missing"),
        (
            'kind = "angular_accelerometer"',
            'kind = "accelerometer"',
            "sensors.yaw.noise_density_m_s2_rthz",
            "is missing",
        ),
        ("[sensors.mass_lateral]", "[sensors.frame_lateral]", "sensors.frame_lateral", "unknown key"),
        ('from = "kalker"', 'from = "given"', "creep.longitudinal_n", "is missing"),
        ("wheelbase_m = 2.56", "", "bogie.wheelbase_m", "is missing"),
        ("wheelbase_m = 2.56", 'wheelbase_m = "2.56"', "bogie.wheelbase_m", "'2.56' is not a number"),
        ("wheelbase_m = 2.56", "wheelbase_m = 0", "bogie.wheelbase_m", "greater than 0"),
        ("wheelbase_m = 2.56", "wheelbase_m = nan", "bogie.wheelbase_m", "not a finite number"),
        ("frame_mass_kg = 2615.0", "frame_mass_kg = 1e300", "bogie.frame_mass_kg", "no number of a vehicle"),
        ("frame_mass_kg = 2615.0", "frame_mass_kg = 1e-300", "bogie.frame_mass_kg", "no number of a vehicle"),
        ("{ value = 300.0, std = 30.0 }", "1e9", "creep.rail_head_radius_mm", "outside Kalker's table"),
        ('from = "kalker"', 'from = "kalker"\nrelative_std = 5.0', "creep.relative_std", "at most 1"),
        ('code = "coach"', 'code = "a\\nb"', "code", "control character"),
        ('code = "coach"', f'code = "{65 * "a"}"', "code", "at most 64"),
        (
            "frame_mass_kg = 2615.0",
            "frame_mass_kg = { value = 2615.0, std = -1.0 }",
            "bogie.frame_mass_kg.std",
            "at least",
        ),
        ('arrangement = "bogie"', 'arrangement = "single_wheelset"', "bogie", "has no effect"),
        (
            "rail_head_radius_mm = { value = 300.0, std = 30.0 }",
            "rail_head_radius_mm = -300.0",
            "creep",
            "greater than 0",
        ),
        (
            "noise_density_m_s2_rthz = 0.98e-3",
            "noise_density_m_s2_rthz = 100.0",
            "sensors.lateral.noise",
            "at most 0.1",
        ),
        ("noise_density_rad_s2_rthz = 1.96e-3", "noise_density_rad_s2_rthz = 2.0", "sensors.yaw.noise", "at most 1"),
        ("range_rad_s2 = 39.0", "range_rad_s2 = 39000.0", "sensors.yaw.range_rad_s2", "at most 20000"),
        ("scale_std = 0.005", "scale_std = 1.0", "sensors.lateral.scale_std", "at most 0.5"),
        ("value = 1813.0, std = 20.0", "value = 1813.0, std = 2000.0", "wheelset.mass_kg.std", "more than the value"),
        ("rate_hz = 250.0", "rate_hz = 5.0", "sensors.rate_hz", "at least 20"),
        ("treadwatch-vehicle-class-1", "treadwatch-registry-1", "format", "is none of"),
    ],
)
def test_bad_input_is_refused_with_file_line_and_field(
    tmp_path: Path, old: str, new: str, field: str, reason: str
) -> None:
    path = edited(tmp_path, "coach", old, new)
    with pytest.raises(InputError) as caught:
        read_vehicle_class(path)
    assert caught.value.file == str(path)
    assert (caught.value.field or "").startswith(field), str(caught.value)
    assert reason in caught.value.reason
    assert caught.value.line is not None


@pytest.mark.parametrize(
    ("name", "moment"),
    [
        ("lateral", "the lateral acceleration of the wheelset"),
        ("yaw", "the moment of its suspension"),
        ("roll", "gravity in the lateral signal"),
        ("mass_lateral", "the yaw of a bogie frame"),
    ],
)
def test_a_layout_that_misses_a_signal_is_refused_with_what_it_cannot_see(
    tmp_path: Path, name: str, moment: str
) -> None:
    text = shipped_path("coach").read_text(encoding="utf-8")
    path = tmp_path / "vehicle.toml"
    path.write_text(re.sub(rf"\[sensors\.{name}\]\n(?:.+\n)+", "", text), encoding="utf-8")
    with pytest.raises(InputError, match=moment) as caught:
        read_vehicle_class(path)
    assert caught.value.field == f"sensors.{name}"
