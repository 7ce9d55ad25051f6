"""The rolling radius from the motion of a wheelset: found whatever is on file, contradicted, silent."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from bogie_run import BOGIE, COACH, SOFT, WHEELBASE, joined, of_bogie, wheelset
from smooth_wheelset import SmoothTable, mems_windows, track

from estimation.geometry.rolling_radius import EXPECTED_STD, check_radius, check_rolling, rolling_radius
from estimation.motion.axle_distance import with_frame_yaw
from estimation.motion.integration import SignalParameters
from estimation.motion.parameters import MOTION
from estimation.motion.rolling_sums import TERMS, UNKNOWNS, RollingSums, rolling_sums
from estimation.values.arrays import FloatArray
from estimation.values.reasons import ReasonCode
from estimation.values.windows import ACCELERATIONS
from estimation.vehicle.vehicle_class import SensorChannel, SensorLayout, VehicleClass
from ingest.simulator.running_gear import RunningGear, simulate_gear

TRUE = 0.45  # m, of ``bogie_run``


def on_file(radius: float, stiffness: float = SOFT) -> VehicleClass:
    known = of_bogie(stiffness)
    return replace(known, parameters=replace(known.parameters, nominal_radius=radius))


def measured(known: VehicleClass, stiffness: float = SOFT, axles: tuple[int, ...] = (1, 2)) -> list[RollingSums]:
    """Return the sums of both wheelsets, which have one radius: four windows."""
    return [
        part for axle in axles for window in joined(stiffness, axle)
        for part in rolling_sums(window, known, SignalParameters())
    ]  # fmt: skip


@pytest.mark.parametrize("stiffness", [SOFT, COACH])
@pytest.mark.parametrize("radius", [0.41, 0.45, 0.49])
def test_the_radius_is_found_whatever_is_on_file(stiffness: float, radius: float) -> None:
    parts = measured(on_file(radius, stiffness), stiffness)
    found = rolling_radius(parts)
    assert found is not None
    assert found.value == pytest.approx(TRUE, abs=6e-3)
    assert 5e-3 < found.std < 1e-2
    reason = check_radius(parts, radius)
    assert (reason is None) == (radius == TRUE)
    if reason is not None:
        assert reason.reason.code is ReasonCode.ROLLING_RADIUS_DIFFERS
        assert f"of {1e3 * found.value:.0f} mm radius" in reason.reason.text
        assert f"on file are {1e3 * radius:.0f} mm" in reason.reason.text
        assert reason.relative == pytest.approx(abs(found.value - radius) / radius)


def test_the_noise_on_file_keeps_the_radius_from_being_too_small() -> None:
    known, quiet = on_file(TRUE), SensorChannel(1e-5)
    sensors = SensorLayout(lateral=quiet, yaw=quiet, roll=quiet, mass_lateral=quiet, measures_gravity=False)
    right, none = (rolling_radius(measured(one)) for one in (known, replace(known, sensors=sensors)))
    assert right is not None
    assert none is not None
    assert right.value - none.value > 5e-3
    unknown = replace(known, sensors=SensorLayout(measures_gravity=False))
    usual = rolling_radius(measured(unknown))
    assert usual is not None
    assert usual.value == pytest.approx(right.value, abs=1e-6), "as of MEMS sensors, which these are"


@dataclass(frozen=True)
class CurvedTable(SmoothTable):
    """Radii and contact angles bend away from the roll: wheels that are hollow."""

    def left(self, x: np.ndarray) -> np.ndarray:
        return 0.45 + self.cone * x + 1.5e4 * x**3

    def right(self, x: np.ndarray) -> np.ndarray:
        return self.left(-x)

    def angle_left(self, x: np.ndarray) -> np.ndarray:
        return 0.13 + 10 * x + 1.5e6 * x**3

    def angle_right(self, x: np.ndarray) -> np.ndarray:
        return self.angle_left(-x)

    @property
    def roll(self) -> np.ndarray:
        return 0.13 * self.lateral_displacement[:, None]


def test_contact_angles_of_curved_contact_do_not_move_the_radius(monkeypatch: pytest.MonkeyPatch) -> None:
    gear = RunningGear(wheelset(COACH), BOGIE)
    ran = simulate_gear(gear, [CurvedTable(), CurvedTable()], track(1), np.full(120_000, 20.0), 20.0)
    front, rear = (mems_windows(one, seed=1, density=1e-4) for one in ran)
    known = of_bogie(COACH)
    parts = [
        part for own, other in zip(front, rear, strict=True)
        for part in rolling_sums(with_frame_yaw(own, other, WHEELBASE), known, SignalParameters())
    ]  # fmt: skip
    found = rolling_radius(parts)
    assert found is not None
    without = EXPECTED_STD.copy()
    without[UNKNOWNS.index("curve")] = 1e-6
    monkeypatch.setattr("estimation.geometry.rolling_radius.EXPECTED_STD", without)
    before = rolling_radius(parts)
    assert before is not None
    assert found.value == pytest.approx(TRUE, rel=0.015)
    assert before.value < 0.97 * TRUE


def test_left_and_right_exchanged_and_short_gaps_change_nothing() -> None:
    known, signals = on_file(TRUE), SignalParameters()
    (window, *_) = joined(SOFT, 1)
    plain = rolling_sums(window, known, signals)
    names = (*ACCELERATIONS, "frame_yaw_acceleration")
    mirrored = replace(window, **{name: -getattr(window, name) for name in names})
    for one, other in zip(plain, rolling_sums(mirrored, known, signals), strict=True):
        np.testing.assert_allclose(other.products, one.products, rtol=1e-9, atol=1e-9 * np.abs(one.products).max())
    lost = window.valid.copy()
    lost[3000:3003] = False
    assert len(rolling_sums(replace(window, valid=lost), known, signals)) == len(plain)
    lost[3000:3500] = False
    with_gap = rolling_sums(replace(window, valid=lost), known, signals)
    assert sum(one.noise[0, 0, 0] for one in with_gap) < sum(one.noise[0, 0, 0] for one in plain)
    assert rolling_sums(replace(window, valid=np.zeros_like(lost)), known, signals) == ()


SIZE = 300.0  # of the regressors


def made(
    parts: int = 16,
    noise: float = 0.0,
    worse: float = 1.0,
    vibration: float = 1.0,
    suspension: float = 1.0,
    scale: float = 1.0,
    inertia: float = 1.0,
    error: float = 1.0,
    radius: float = TRUE,
) -> list[RollingSums]:
    """Return sums of drawn regressors that follow the equation but for an error, on file of size 1.

    On file the roll is measured with ``noise``, in truth with ``worse`` times that, in the last band with
    ``vibration`` times that besides.
    """
    rng, n = np.random.default_rng(3), 400
    truth = np.array([scale, radius, inertia, suspension, 0.0, 0.0])
    found = []
    for _ in range(parts):
        products, of_noise = (
            np.zeros((MOTION.wavelength_bands, TERMS, TERMS)),
            np.zeros((MOTION.wavelength_bands, TERMS, TERMS)),
        )
        for band in range(MOTION.wavelength_bands):
            x = SIZE * rng.standard_normal((n, TERMS - 1))
            y = x @ truth + error * rng.standard_normal(n)
            x[:, 1] += (
                noise * worse * (vibration if band == MOTION.wavelength_bands - 1 else 1.0) * rng.standard_normal(n)
            )
            rows: FloatArray = np.column_stack([y, x])
            products[band] = rows.T @ rows
            of_noise[band, 0, 0], of_noise[band, 2, 2] = n, n * noise**2
        found.append(RollingSums(products, of_noise))
    return found


def test_a_radius_is_in_doubt_from_2_standard_deviations_and_wrong_from_4() -> None:
    parts = made()
    found = rolling_radius(parts)
    assert found is not None
    assert found.value == pytest.approx(TRUE, abs=1e-3)
    assert found.std == pytest.approx(5e-3, rel=0.02)
    for side in (-1.0, 1.0):
        for stds, certain in ((1.95, None), (2.05, False), (3.95, False), (4.05, True)):
            on_file = found.value + side * stds * found.std
            said = check_radius(parts, on_file)
            assert (None if said is None else said.certain) is certain
            measured = check_radius(parts, on_file, measured=True)
            assert (None if measured is None else measured.certain) is (None if certain is None else False)
    assert check_radius(parts, found.value + 2.05 * found.std, relative_std=0.01) is None


def test_what_varies_from_wavelength_to_wavelength_widens_the_interval() -> None:
    """A band in which the radius seems 10 % smaller moves it by a sixth of that; the jackknife of bands says so."""
    plain, parts = made(error=50.0), []
    for one in plain:
        products = one.products.copy()
        products[0, 0] -= 0.1 * TRUE * products[0, 2]
        products[0, :, 0] -= 0.1 * TRUE * products[0, :, 2]
        parts.append(replace(one, products=products))
    found, before = rolling_radius(parts), rolling_radius(plain)
    assert found is not None
    assert before is not None
    moved = abs(found.value - before.value)
    assert moved == pytest.approx(0.1 * TRUE / MOTION.wavelength_bands, rel=0.1)
    assert found.std == pytest.approx(math.hypot(before.std, moved), rel=0.1)


def test_too_little_data_say_nothing() -> None:
    assert rolling_radius(made(8)) is not None
    assert rolling_radius(made(7)) is None
    assert check_radius(made(7), 0.3) is None
    nothing = RollingSums(
        np.zeros((MOTION.wavelength_bands, TERMS, TERMS)), np.zeros((MOTION.wavelength_bands, TERMS, TERMS))
    )
    assert check_radius([nothing] * 8, 0.3, measured=True) is None


def test_a_radius_that_neither_motion_nor_measurement_confirms_is_open() -> None:
    """Two stds must leave out a mistake of 10 %: 45 mm."""
    parts = made()
    found = rolling_radius(parts)
    assert found is not None
    assert 0.0 < found.bound < found.std
    for relative_std, is_open in ((0.0480, False), (0.0500, True)):
        said = check_radius(parts, found.value, relative_std)
        assert (said is not None) is is_open
        assert check_radius(parts, found.value, relative_std, measured=True) is None
    assert said is not None
    assert (said.reason.code, said.certain, said.relative) == (ReasonCode.ROLLING_RADIUS_OPEN, False, 0.0)
    assert "450 mm on file" in said.reason.text
    nothing = RollingSums(
        np.zeros((MOTION.wavelength_bands, TERMS, TERMS)), np.zeros((MOTION.wavelength_bands, TERMS, TERMS))
    )
    silent = check_radius([nothing] * 8, 0.3)
    assert silent is not None
    assert silent.reason.code is ReasonCode.ROLLING_RADIUS_OPEN
    assert check_radius([nothing] * 7, 0.3) is None, "too few to say anything"


@pytest.mark.parametrize(("stds", "doubted"), [(2.45, False), (2.55, True)])
@pytest.mark.parametrize("scale_std", [0.0, 0.01])
def test_a_scale_that_sensors_do_not_have_is_doubted(stds: float, scale_std: float, *, doubted: bool) -> None:
    off = stds * math.hypot(0.01, scale_std)
    said = check_rolling(made(scale=1.0 + off), TRUE, 0.01, measured=True, scale_std=scale_std)
    assert (said is not None) is doubted
    if said is not None:
        assert (said.reason.code, said.certain) == (ReasonCode.SCALE_DIFFERS, False)
        assert said.relative == pytest.approx(off, rel=0.02)


def test_a_radius_that_is_another_goes_before_a_scale_and_a_stiff_bogie_shows_none() -> None:
    parts = made(scale=1.04)
    assert check_rolling(parts, TRUE, 0.01, measured=True) is None, "creep that saturates looks like it"
    other = check_rolling(parts, 0.5 * TRUE, scale_std=0.0)
    assert other is not None
    assert (other.reason.code, other.certain) == (ReasonCode.ROLLING_RADIUS_DIFFERS, True)
    assert check_rolling(made(7, scale=1.04), TRUE, scale_std=0.0) is None


@pytest.mark.parametrize("inertia", [0.6, 1.4])
def test_inertia_that_no_wheelset_has_widens_the_interval(inertia: float) -> None:
    """In a coach creep that saturates shows as inertia, and radii are found as much as 90 mm too large."""
    found = rolling_radius(made(inertia=inertia))
    assert found is not None
    assert found.std == pytest.approx(math.hypot(5e-3, 0.15 * 0.4 * TRUE), rel=0.03)


def test_low_friction_widens_the_interval() -> None:
    found = rolling_radius(made(suspension=1.2))
    assert found is not None
    assert found.std == pytest.approx(math.hypot(5e-3, 0.3 * 0.2 * TRUE), rel=0.03)
    stiff = rolling_radius(made(suspension=0.8))
    assert stiff is not None
    assert stiff.std == pytest.approx(5e-3, rel=0.02)


def test_a_scale_that_sensors_do_not_have_widens_the_interval() -> None:
    for scale in (0.9, 1.1):
        found = rolling_radius(made(scale=scale))
        assert found is not None
        assert found.std == pytest.approx(math.hypot(5e-3, 0.5 * 0.1 * TRUE), rel=0.03)


def test_motion_that_the_equation_does_not_explain_says_nothing() -> None:
    of_roll = TRUE * SIZE
    assert rolling_radius(made(error=math.sqrt(0.18) * of_roll)) is not None
    assert rolling_radius(made(error=math.sqrt(0.22) * of_roll)) is None
    assert rolling_radius(made(radius=-TRUE)) is None


@pytest.mark.parametrize(
    ("worse", "vibration", "doubt"), [(1.0, 1.0, 0.1), (math.sqrt(2.0), 1.0, 0.1 + 0.6), (1.0, 3.0, 0.4)]
)
def test_a_share_of_what_noise_does_is_in_doubt(worse: float, vibration: float, doubt: float) -> None:
    noise = 100.0
    found = rolling_radius(made(noise=noise, worse=worse, vibration=vibration))
    assert found is not None
    seen = SIZE**2 + (worse * noise) ** 2
    corrected = TRUE * SIZE**2 / (seen - noise**2) - TRUE * SIZE**2 / seen
    assert found.value == pytest.approx(TRUE * SIZE**2 / (seen - noise**2), abs=4e-3)
    assert found.std == pytest.approx(math.hypot(5e-3, doubt * corrected), rel=0.1)


def test_noise_on_file_that_the_data_do_not_have_is_not_taken_off() -> None:
    parts = made(noise=100.0, worse=0.1)
    found = rolling_radius(parts)
    assert found is not None
    assert found.value == pytest.approx(TRUE, abs=4e-3)
