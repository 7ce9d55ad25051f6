"""Small inputs that run every compiled kernel of the product, every line of it, with every type of arguments."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import estimator_kernel_runs
import ingest_kernel_runs
import numpy as np
from numba.core.registry import CPUDispatcher

from estimation.adhesion.creep_forces import filter_forward, smooth_back
from estimation.adhesion.window_adhesion import add_saturated, excess_table
from estimation.contact.conicity import equivalent_conicity, middle_of_travel
from estimation.contact.geometry import ContactTable, WheelsetOnTrack, contact_table, radius_difference_curve
from estimation.contact.method import ContactMethod
from estimation.contact.profiles import rail_profile, wheel_profile
from estimation.errors import ContactError
from estimation.estimators.interface import EstimatorParameters
from estimation.estimators.paper_algorithm import PaperAlgorithm, recursion_in_bins
from estimation.filters import local_cubic_kernel, remove_wander
from estimation.motion.integration import integrate_once, integrate_twice, take_out_mean
from estimation.motion.rolling_radius_difference import sample_smoothed
from estimation.motion.rolling_sums import ROWS, Equation, add_spectra, write_pieces
from estimation.motion.window_motion import evaluate
from estimation.tables.bin_table import BinParameters, fill_cells, group_of
from estimation.track.panel.basis import add_filtered_hats
from estimation.track.screening.agreement import cross_products, own_products
from estimation.values.arrays import FloatArray, frozen_array
from estimation.values.windows import Motion
from estimation.vehicle.regressors import Signals, regression
from estimation.vehicle.vehicle_class import BogieParameters, VehicleParameters
from ingest.catalogue import default_catalogue
from ingest.codec import decode, encode
from ingest.frames import batch_of, concatenate
from ingest.simulator.rates import Wheels
from ingest.simulator.running import Creep, CreepLaw
from ingest.simulator.running_gear import RunningGear, simulate_gear
from ingest.simulator.track import Curves, Surface, TrackTruth

Results = dict[str, list[FloatArray]]


def results() -> Results:
    """Return what every run gives, by its name."""
    return {run.__name__.strip("_"): list(run()) for run in RUNS}


def _contact() -> Iterator[FloatArray]:
    worn = WheelsetOnTrack.symmetric(wheel_profile("P8"), rail_profile("56E1"), 1 / 20, 1.435)
    for method, y in ((ContactMethod.RIGID, (-7e-3, 0.0, 8e-3)), (ContactMethod.EN15302, (0.0, 3e-3))):
        table = contact_table(worn, y, (-2e-3, 3e-3), method=method)
        yield from _columns(table)
    other = WheelsetOnTrack.symmetric(wheel_profile("EN15302-A"), rail_profile("60E2"), 1 / 40, 1.435)
    yield from _columns(contact_table(other, np.linspace(-8e-3, 8e-3, 5)))
    curve = radius_difference_curve(worn, np.linspace(-1e-3, 1e-3, 3), method=ContactMethod.EN15302)
    yield from (curve.displacement, curve.difference, curve.jumps)
    yield radius_difference_curve(worn, (-60e-3, 0.0, 0.2e-3, 150e-3)).difference
    off = contact_table(worn, (-60e-3, 0.0, 50e-3, 150e-3), outside="hold")
    yield from _columns(off)
    try:
        contact_table(worn, (0.3,))
    except ContactError as error:
        yield np.array([len(str(error))])


def _columns(table: ContactTable) -> Iterator[FloatArray]:
    yield from (table.roll, table.contact_position_left, table.rail_position_right, table.rolling_radius_difference)
    yield from (table.exists.astype(float), table.jump.astype(float))


def _conicity() -> Iterator[FloatArray]:
    y = np.linspace(-8e-3, 8e-3, 33)
    waves = 0.2 * y + 0.9e-3 * np.sin(y / 0.8e-3)
    steps = np.sign(y) * np.maximum(np.abs(y) - 1.2e-3, 0.0)
    touching = np.minimum(0.3 * (y - y[-1]), -1e-3)
    touching[-1] = 1e-300  # the crossing is the last point itself
    for curve in (
        0.3 * y,
        0.3 * y - 0.4e-3,
        touching,
        waves,
        steps,
        -0.3 * y,
        np.abs(y) + 1e-3,
        y * (36e-6 - y * y) * 1e4,
    ):
        yield equivalent_conicity(y, curve, (0.5e-3, 1e-3, 2e-3, 3e-3, 5e-3, 7.5e-3, 20e-3))
        yield np.array([middle_of_travel(y, curve, 3e-3)])


def _paper() -> Iterator[FloatArray]:
    rng = np.random.default_rng(4)
    features = np.column_stack([rng.standard_normal((60, 2)), np.ones(60)])
    output = features @ [3.0, -2.0, 0.5] + 0.01 * rng.standard_normal(60)
    yield recursion_in_bins(features, output, np.arange(60) % 2, 3, PaperAlgorithm(threshold=10, forgetting=0.99))[0]


def _bin_tables() -> Iterator[FloatArray]:
    rng = np.random.default_rng(8)
    n = 60
    values = dict(zip(Signals._fields, 1e-2 * rng.standard_normal((len(Signals._fields), n)), strict=True))
    values |= {"displacement": 3e-3 * rng.standard_normal(n), "speed": np.full(n, 20.0)}
    valid, block = np.arange(n) % 7 > 0, np.arange(n) // 20 + 80_000_000
    in_bogie = Motion(**values, valid=valid, block=block, band_limited=True)
    alone = replace(in_bogie, frame_yaw=None, frame_yaw_rate=None, frame_displacement=None)
    for motion, parameters in ((alone, BinParameters()), (in_bogie, BinParameters(wheelbase=2.5))):
        cells = fill_cells(motion, parameters)
        yield from (cells.weight, cells.lateral, cells.yaw)
        equations = regression(motion, parameters.vehicle)
        yield equations.yaw_targets
    yield group_of(block, 16).astype(float)


def _creep_filter() -> Iterator[FloatArray]:
    rng = np.random.default_rng(12)
    samples, n, m = 6, 5, 4
    transition, measured = 0.3 * rng.standard_normal((n, n)), rng.standard_normal((n, m))
    gain, back = 0.1 * rng.standard_normal((m, n)), 0.2 * rng.standard_normal((n, n))
    fixed = {name: frozen_array(value, value.shape, name=name) for name, value in
             (("transition", transition), ("measured", measured), ("gain", gain), ("back", back))}  # fmt: skip
    measurements = frozen_array(rng.standard_normal((samples, m)), (samples, m), name="measurements")
    excess = frozen_array(0.1 * rng.standard_normal(samples), (samples,), name="excess")
    known = frozen_array(np.arange(samples) % 4 > 0, (samples,), np.bool_, name="known")
    predicted, filtered, innovations = np.empty((samples, n)), np.empty((samples, n)), np.empty((samples, m))
    filter_forward(
        fixed["transition"],
        fixed["measured"],
        fixed["gain"],
        measurements,
        known,
        np.array([1, 3]),
        excess,
        predicted,
        filtered,
        innovations,
    )
    smooth_back(fixed["back"], predicted, filtered)
    yield from (predicted, filtered, innovations)


def _saturation() -> Iterator[FloatArray]:
    rng = np.random.default_rng(13)
    saturated = np.zeros((2, 4, 3))
    forces = rng.standard_normal((3, 5)) * np.array([[2000.0], [3000.0], [800.0]])
    bounds, place = np.array([9e3, 3e3, 1e3]), np.array([0, 0, 1, 1, 0])
    add_saturated(excess_table(), rng.standard_normal((3, 5)), forces, place, bounds, saturated)
    yield saturated


def _rolling_radius() -> Iterator[FloatArray]:
    rng = np.random.default_rng(9)
    speeds, part, starts = np.empty(2), np.arange(2), np.array([0, 20])
    pieces, samples = np.empty((2, ROWS, 40)), rng.standard_normal((6, 60))
    samples[5] += 20.0
    taper = frozen_array(np.hanning(40), (40,), name="taper")
    write_pieces(samples, starts, 0.02, taper, pieces, speeds)
    equation = Equation(
        lateral_creep_coefficient=7e6, lateral_spin_creep_coefficient=1e4, wheelset_mass=1e3, lateral_stiffness=2e5,
        lateral_damping=5e4, load=1e4, half_contact_distance=0.75, yaw_inertia=7e2, yaw_stiffness=2e6, yaw_damping=1e3,
        nominal_radius=0.45, per_moment=9e-8, yaw_creep=8e6, pitch=4e2, wheelbase=2.5,
        gravity=9.81, yaw_is_gyroscope=False, roll_is_gyroscope=True,
    )  # fmt: skip
    products, noise = np.zeros((2, 2, 6, 7, 7))
    densities = np.full(4, 1e-6), np.full(4, 1e-8)
    place = (0.02, 40, 1.0, equation, *densities, (2.5, 10.0))
    add_spectra(np.fft.rfft(pieces), speeds, part, *place, products, noise)
    yield from (pieces, products, noise)


def _smoothing_spline() -> Iterator[FloatArray]:
    rng = np.random.default_rng(7)
    known = np.ones(90, bool)
    known[30:40] = False
    yield remove_wander(rng.standard_normal((2, 90)), np.linspace(0.0, 30.0, 90), known, 20.0)
    unknown = np.array([0.0, np.nan, 2.0, 3.0, 4.0])
    try:
        remove_wander(np.ones((1, 5)), unknown, np.ones(5, bool), 20.0)
    except np.linalg.LinAlgError as error:
        yield np.array([len(str(error))])


def _frames() -> Iterator[FloatArray]:
    catalogue = default_catalogue()
    plan = catalogue.find("ACCELERATION", 3)
    wanted = np.array([0.3, 1e9, -1e9, np.nan])
    good = encode(plan, np.arange(4), {plan.names[0]: wanted})
    payloads = np.zeros((2, 8), np.uint8)
    strange = [batch_of(plan.arbitration_id, np.arange(2), payloads, 3), batch_of(0x7FE, np.arange(2), payloads, 8)]
    uneven = next(plan for plan in catalogue.messages.values() if not plan.four_int16)
    zeros = np.zeros(3)
    odd = encode(uneven, np.arange(3), {uneven.names[0]: zeros})
    decoded = decode(catalogue, concatenate([good, odd, *strange]))
    yield decoded.messages[plan.arbitration_id].values()
    yield decoded.messages[uneven.arbitration_id].values()
    counts = decoded.counts
    yield np.array([counts.decoded, counts.wrong_lengths, counts.unknown_identifiers, counts.clipped_values])


def _simulator() -> Iterator[FloatArray]:
    s = np.linspace(0.0, 20.0, 41)
    track = TrackTruth(s=s, alignment=2e-3 * np.sin(s / 2.0), gauge_deviation=1e-3 * np.cos(s / 3.0))
    speed = np.concatenate([np.zeros(4), np.linspace(0.0, 12.0, 40)])
    start = np.zeros(11)
    start[2] = 1e-3
    for table in (Cones(np.zeros(1)), Cones(np.array([-2e-3, 0.0, 2e-3]))):
        motion = simulate_gear(RunningGear(), [table], track, speed, 1.0, initial=start)[0]
        yield from (motion.lateral_displacement, motion.yaw, motion.mass_lateral_acceleration, motion.roll_rate)
    far = np.zeros(11)
    far[0] = 0.1
    yield np.array([simulate_gear(RunningGear(), [table], track, speed[-6:], 1.0, initial=far)[0].outside])


def _running_gears() -> Iterator[FloatArray]:
    s = np.linspace(0.0, 20.0, 41)
    curves = Curves(1e-3 * np.sin(s / 5.0), 1e-2 * np.cos(s / 5.0))
    surface = Surface(1e-3 * np.sin(s), 1.0 + 0.1 * np.sin(s), 1.0 + 0.2 * np.cos(s))
    track = TrackTruth(s, 2e-3 * np.sin(s / 2.0), 1e-3 * np.cos(s / 3.0), curves, surface)
    speed, cones = np.concatenate([np.zeros(4), np.linspace(0.0, 12.0, 40)]), Cones(np.zeros(1))
    bogie = BogieParameters(2.5, frame_mass=2e3, frame_yaw_inertia=2e3, body_mass=1e4)
    wheels = (Wheels((1e-4, 0.0), (1.0, 0.0)),) * 2
    for law in CreepLaw:
        gear = RunningGear(VehicleParameters(), bogie, Creep(law), wheels, traction=(1.0, 1.0))
        for motion in simulate_gear(gear, [cones, cones], track, speed, 5.0):
            yield from (motion.lateral_displacement, motion.yaw, motion.mass_lateral_acceleration, motion.roll_rate)
    (round_wheels,) = simulate_gear(RunningGear(), [cones], replace(track, surface=None), speed, 5.0)
    yield round_wheels.lateral_displacement
    far = simulate_gear(RunningGear(), [cones], track, speed[-6:], 5.0, initial=np.full(11, 0.1))
    yield np.array([far[0].outside])


def _stretches() -> Iterator[FloatArray]:
    rng = np.random.default_rng(6)
    n = 90
    signals = list(rng.standard_normal((10, n)) * 1e-3)
    y, y1, y2, yaw, yaw1, yaw2, roll, roll1, apart, apart1 = signals
    speed, valid, block = np.full(n, 20.0), np.ones(n, bool), np.arange(n) // 30
    motion = Motion(speed, y, y1, y2, yaw, yaw1, yaw2, roll, roll1, apart, apart1, valid, block, band_limited=False)
    algorithm = PaperAlgorithm(width=2e-3, threshold=10)
    state = algorithm.update(algorithm.update(algorithm.init(EstimatorParameters()), motion), motion, weight=0.5)
    yield from (state.theta, state.squares)


@dataclass(frozen=True)
class Cones:
    """Two cones, whose radii follow the gauge a little."""

    gauge_deviation: FloatArray
    lateral_displacement: FloatArray = field(default_factory=lambda: np.linspace(-12e-3, 12e-3, 25))

    @property
    def rolling_radius_left(self) -> FloatArray:
        """(n, g) m."""
        return 0.45 + 0.1 * (self.lateral_displacement[:, None] + 0.2 * self.gauge_deviation)

    @property
    def rolling_radius_right(self) -> FloatArray:
        """(n, g) m."""
        return self.rolling_radius_left[::-1]

    @property
    def contact_angle_left(self) -> FloatArray:
        """(n, g) rad."""
        return 0.1 + self.roll

    @property
    def contact_angle_right(self) -> FloatArray:
        """(n, g) rad."""
        return 0.1 - self.roll

    @property
    def roll(self) -> FloatArray:
        """(n, g) rad."""
        return (self.rolling_radius_left - self.rolling_radius_right) / 1.5


def _passes() -> Iterator[FloatArray]:
    rng = np.random.default_rng(7)
    signals, at = rng.standard_normal((3, 40)), np.cumsum(rng.uniform(0.05, 0.2, 40))
    weights = local_cubic_kernel(1.0, 0.0625)
    yield sample_smoothed(signals, at, -8, 30, 4, 0.0625, weights)
    yield cross_products(signals[:2], signals[1:], 5).ravel()
    yield own_products(signals, 5)
    rows, share = np.zeros((4, 40), np.float32), rng.uniform(size=40).astype(np.float32)
    add_filtered_hats(rows, np.arange(40) % 3, share, share, weights.astype(np.float32))
    yield rows.astype(np.float64)


def _integrals() -> Iterator[FloatArray]:
    rows = np.random.default_rng(8).standard_normal((2, 12))
    rates, displacements, run = np.empty_like(rows), np.empty_like(rows), np.empty(12)
    take_out_mean(rows)
    integrate_twice(rows, 0.1, rates, displacements)
    integrate_once(rows[0], 0.1, run)
    yield from (rates, displacements, run)
    s, coefficients = np.linspace(0.0, 3.0, 4), np.arange(12.0).reshape(3, 4)
    places = np.array([-1.0, 0.0, 1.0, 1.0 + 1e-16, 1.9, 2.5, 3.0, 4.0, np.nan])
    found = np.full(len(places), -1.0)
    evaluate(places, s, coefficients, found)
    shifted = np.array([0.0, 1.4, 1.6, 3.0])  # whose points are off an even grid
    uneven = np.full(len(places), -1.0)
    evaluate(places, shifted, coefficients, uneven)
    yield from (found, uneven)


RUNS: tuple[Callable[[], Iterator[FloatArray]], ...] = (
    _contact,
    _conicity,
    _paper,
    _stretches,
    _bin_tables,
    _creep_filter,
    _saturation,
    _rolling_radius,
    _smoothing_spline,
    _frames,
    _simulator,
    _running_gears,
    _passes,
    _integrals,
    *estimator_kernel_runs.RUNS,
    *ingest_kernel_runs.RUNS,
)


def product_kernels() -> dict[str, CPUDispatcher]:
    """Return every compiled function of the product, by its name."""
    found = {}
    for package in ("api", "ingest", "fleet_db", "estimation"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
            if module.name.endswith(("__main__", "migrations.env")):  # both run when imported
                continue
            for value in vars(importlib.import_module(module.name)).values():
                if isinstance(value, CPUDispatcher):
                    found[f"{value.py_func.__module__}.{value.py_func.__qualname__}"] = value
    return found
