"""The simulation behind a section scenario: what every wheelset's sensors count on every journey, kept on disk.

Only what shapes the motion or the sensors is part of the key, so that scenarios which differ in what is known of the
section share one simulation. Every random stream has a key of its own.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import numpy.typing as npt

from estimation.contact.geometry import WheelsetOnTrack, contact_table
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.contact.table import ContactTable
from estimation.contact.wear import WearFamily, wear_course, worn
from estimation.errors import ScenarioError
from estimation.values.arrays import FloatArray
from estimation.values.windows import ACCELERATIONS
from estimation.vehicle.equations_of_motion import VehicleParameters
from ingest.catalogue import ACCELERATION, MOTION, VEHICLE_NODE, default_catalogue
from ingest.simulator.motion import STEP, WheelsetMotion, simulate_wheelset, travelled
from ingest.simulator.section_scenario import ProfilePair, SectionScenario
from ingest.simulator.sensors import draw_offsets, measure
from ingest.simulator.track import TrackRecipe, TrackTruth, make_track
from ingest.simulator.wear import GAUGE_STEP, gauge_grid

SIMULATION_VERSION = 1
MARGIN = 200.0  # m of track beyond both ends
LEAD_IN = 160.0  # m before the section where a run begins
AXLE_SPACING = 2.6  # m
GAUGE = 1.435  # m, nominal
REACH = 12e-3  # m of lateral displacement in the contact tables
WIDE_REACH = 15e-3  # m, the same where gauge varies: flanges are further apart in wide gauge
DISPLACEMENT_STEP = 0.05e-3  # m
ASYMMETRY = 0.08  # std of the share by which left wear is above the mean
SHARES_OF_WEAR = (1.0, 0.85, 0.7, 0.5, 1.5)  # tried in turn, until a wheelset stays on the rails
NORMAL_95 = 1.96  # a 95 % limit in standard deviations
POSITION, _TRACK, _WEAR, _SPEED, _SENSOR, _OFFSETS, _CREEP, _VEHICLE, PROFILES = range(9)
RawCounts = npt.NDArray[np.int16]


@dataclass(frozen=True, slots=True)
class Resolution:
    """SI value of one count."""

    accelerations: tuple[float, float, float, float]  # in the order of ACCELERATIONS
    speed: float  # m/s

    @staticmethod
    def of_the_bus() -> Resolution:
        """Return what the signal catalogue gives a count."""
        catalogue = default_catalogue()
        message = catalogue.find(ACCELERATION, 1)
        lateral, yaw, roll, mass = (message.signal(name).scale for name in ACCELERATIONS)
        return Resolution((lateral, yaw, roll, mass), catalogue.find(MOTION, VEHICLE_NODE).signal("speed").scale)


def stream(seed: int, kind: int, *place: int) -> np.random.Generator:
    """Return a random stream: the same for the same seed and key, whatever was drawn before."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(kind, *place)))


def simulation_key(scenario: SectionScenario, seed: int) -> str:
    """Return the digest of everything that shapes the simulation."""
    shaping = {
        "version": SIMULATION_VERSION,
        "seed": seed,
        "pair": asdict(scenario.pair(seed)),
        "errors": asdict(scenario.vehicle_errors) if scenario.errors_drawn else None,
        "sensors": asdict(scenario.sensors),
        **({"gauge_step": GAUGE_STEP, "reach": WIDE_REACH} if scenario.gauge_std else {}),
        **{name: getattr(scenario, name) for name in _SHAPING},
    }
    return hashlib.sha256(json.dumps(shaping, sort_keys=True).encode()).hexdigest()[:20]


_SHAPING = (
    "vehicles",
    "wheelsets",
    "passes",
    "wear_alike",
    "length",
    "alignment_std",
    "gauge_std",
    "lowest_speed",
    "highest_speed",
    "speed_alike",
)


def section_track(scenario: SectionScenario, seed: int) -> TrackTruth:
    """Return the true track, ``MARGIN`` longer than the section at both ends."""
    recipe = TrackRecipe(
        length=scenario.length + 2 * MARGIN, alignment_std=scenario.alignment_std, gauge_std=scenario.gauge_std
    )
    made = make_track(recipe, np.random.SeedSequence(seed, spawn_key=(_TRACK,)))
    return TrackTruth(made.s - MARGIN, made.alignment, made.gauge_deviation)


def journey_speed(scenario: SectionScenario, seed: int, vehicle: int, journey: int) -> FloatArray:
    """Return the speed (n,), m/s, every ``STEP`` s until the last axle has run through the section."""
    low, high = scenario.lowest_speed, scenario.highest_speed
    to_run = scenario.length + LEAD_IN + AXLE_SPACING * scenario.wheelsets + 50.0
    t = np.arange(int(to_run / low / STEP) + 2) * STEP
    if scenario.speed_alike:
        speed = np.full(len(t), 0.5 * (low + high))
    else:
        rng = stream(seed, _SPEED, vehicle, journey)
        swing = rng.uniform(0.045, 0.18) * (high - low)
        wave = np.sin(2 * np.pi * t / rng.uniform(60, 200) + rng.uniform(0, 2 * np.pi))
        mean = rng.uniform(low + 0.1 * (high - low), high - 0.18 * (high - low))
        speed = np.clip(mean + swing * wave, low, high)
    return np.asarray(speed[: int(np.searchsorted(travelled(speed, 0.0), to_run)) + 1])


def axle_start(axle: int) -> float:
    """Return where the wheelset at ``axle`` (from 0) is at the begin of a run, m along the section."""
    return -LEAD_IN - AXLE_SPACING * axle


def vehicle_parameters(scenario: SectionScenario, seed: int, vehicle: int) -> VehicleParameters:
    """Return the true parameters of a vehicle: the assumed ones, or drawn around them."""
    standard = VehicleParameters()
    if not scenario.errors_drawn:
        return standard
    limits = scenario.vehicle_errors
    creep = 1.0 + limits.creep / NORMAL_95 * stream(seed, _CREEP).standard_normal()
    lateral, yaw, wheelset, body = stream(seed, _VEHICLE, vehicle).standard_normal(4) / NORMAL_95
    stiff_lateral, stiff_yaw = 1.0 + limits.stiffness * lateral, 1.0 + limits.stiffness * yaw
    heavy_wheelset, heavy_body = 1.0 + limits.mass * wheelset, 1.0 + limits.mass * body
    return replace(
        standard,
        longitudinal_creep_coefficient=creep * standard.longitudinal_creep_coefficient,
        lateral_creep_coefficient=creep * standard.lateral_creep_coefficient,
        lateral_spin_creep_coefficient=creep * standard.lateral_spin_creep_coefficient,
        lateral_stiffness=stiff_lateral * standard.lateral_stiffness,
        yaw_stiffness=stiff_yaw * standard.yaw_stiffness,
        wheelset_mass=heavy_wheelset * standard.wheelset_mass,
        yaw_inertia=heavy_wheelset * standard.yaw_inertia,
        pitch_inertia=heavy_wheelset * standard.pitch_inertia,
        suspended_mass=heavy_body * standard.suspended_mass,
        load=heavy_body * standard.load,
    )


def wheelset_contact(
    scenario: SectionScenario, seed: int, number: int, track: TrackTruth, share_of_wear: float = 1.0
) -> ContactTable:
    """Return the true contact geometry of wheelset ``number``, rigid with roll, over the gauges of ``track``.

    With ``share_of_wear`` below 1 its wear is that much less deep than drawn.
    """
    pair, total = scenario.pair(seed), scenario.vehicles * scenario.wheelsets
    rng = stream(seed, _WEAR, number)
    share, apart = (number + rng.uniform()) / total, rng.normal(0.0, ASYMMETRY)
    if scenario.wear_alike:
        share, apart = 0.5, 0.0
    rail = rail_profile(pair.rail)
    left, right = (_worn(pair, share_of_wear * pair.deepest_wear * share * (1.0 + side)) for side in (apart, -apart))
    wheelset = WheelsetOnTrack(left, right, rail, rail, pair.inclination, GAUGE)
    half = round(_reach(scenario) / DISPLACEMENT_STEP)
    grid = DISPLACEMENT_STEP * np.arange(-half, half + 1)
    return contact_table(wheelset, grid, gauge_grid(track), outside="hold")


def _reach(scenario: SectionScenario) -> float:
    return WIDE_REACH if scenario.gauge_std else REACH


def _worn(pair: ProfilePair, depth: float) -> Profile:
    family = WearFamily.S1002_ON_60E1 if "1002" in pair.wheel else WearFamily.P8_ON_56E1
    return worn(wheel_profile(pair.wheel), wear_course(family, depth))


def wheelset_file(folder: Path, number: int) -> Path:
    """Return where the simulation of wheelset ``number`` lies."""
    return folder / f"wheelset_{number:03d}.npz"


def ensure_simulated(
    scenario: SectionScenario,
    seed: int,
    cache: Path,
    *,
    workers: int = 2,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Path:
    """Return the folder with the simulation, made if it is not there; it appears whole or not at all.

    Parameters
    ----------
    scenario, seed
        What to simulate.
    cache
        Folder of all simulations.
    workers
        Processes; 1 stays in this one.
    progress
        Told (wheelsets done, of).

    Raises
    ------
    ScenarioError
        A wheelset leaves its contact geometry: the scenario lets it derail.
    """
    target = cache / simulation_key(scenario, seed)
    if target.is_dir():
        return target
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache, prefix="unfinished-") as unfinished:
        folder = Path(unfinished) / "simulation"
        folder.mkdir()
        _simulate_all(scenario, seed, folder, workers, progress)
        try:
            folder.rename(target)
        except OSError:
            if not target.is_dir():  # else another process was faster, with the same content
                raise
    return target


def _simulate_all(
    scenario: SectionScenario, seed: int, folder: Path, workers: int, progress: Callable[[int, int], None]
) -> None:
    numbers = range(scenario.vehicles * scenario.wheelsets)
    if workers == 1:
        for number in numbers:
            simulate_section_wheelset(scenario, seed, number, folder)
            progress(number + 1, len(numbers))
        return
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        futures = [pool.submit(simulate_section_wheelset, scenario, seed, number, folder) for number in numbers]
        try:
            for done, future in enumerate(as_completed(futures), start=1):
                future.result()
                progress(done, len(numbers))
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def simulate_section_wheelset(scenario: SectionScenario, seed: int, number: int, folder: Path) -> None:
    """Write the counts of wheelset ``number`` on every journey, and its true contact geometry, to ``folder``."""
    table, motions = _on_the_rails(scenario, seed, number)
    offsets = draw_offsets(scenario.sensors, stream(seed, _OFFSETS, number))
    resolution = Resolution.of_the_bus()
    counts: dict[str, RawCounts] = {}
    for journey, motion in enumerate(motions):
        record = measure(motion, scenario.sensors, stream(seed, _SENSOR, number, journey), offsets)
        counts[f"counts_{journey}"] = _counted(record.values, resolution)
    nominal = int(np.argmin(np.abs(table.gauge_deviation)))
    np.savez(
        wheelset_file(folder, number),
        displacement=table.lateral_displacement,
        difference=table.rolling_radius_difference[:, nominal],
        radius_sum=table.rolling_radius_sum[:, nominal],
        angle_sum=table.contact_angle_sum[:, nominal],
        angle_difference=table.contact_angle_difference[:, nominal],
        **counts,  # type: ignore[arg-type] # the stubs take the keywords for allow_pickle
    )


def _on_the_rails(scenario: SectionScenario, seed: int, number: int) -> tuple[ContactTable, list[WheelsetMotion]]:
    """Return contact geometry and journeys of a wheelset with the first of ``SHARES_OF_WEAR`` that does not derail.

    In narrow places a worn wheelset may hunt until it leaves the rails, and a nearly new one too: no railway runs them.
    """
    track = section_track(scenario, seed)
    vehicle, axle = number % scenario.vehicles, number // scenario.vehicles
    parameters = vehicle_parameters(scenario, seed, vehicle)
    speeds = [journey_speed(scenario, seed, vehicle, journey) for journey in range(scenario.passes)]
    outside = 0
    for share in SHARES_OF_WEAR:
        table = wheelset_contact(scenario, seed, number, track, share)
        motions = [simulate_wheelset(parameters, table, track, speed, axle_start(axle)) for speed in speeds]
        outside = max(motion.outside for motion in motions)
        if not outside:
            return table, motions
    others = ", ".join(f"{share:.0%}" for share in SHARES_OF_WEAR[1:])
    raise ScenarioError(
        f"wheelset {number} of seed {seed} derails, even with {others} of its wear: "
        f"{outside} samples beyond {1e3 * _reach(scenario):g} mm; less wear or a lower speed keeps it from hunting",
        field="pairs.deepest_wear_mm",
    )


def _counted(values: FloatArray, resolution: Resolution) -> RawCounts:
    """Return what the bus carries: int16 counts, held at the ends of their range."""
    counts = np.rint(values / np.array(resolution.accelerations))
    return np.asarray(np.clip(counts, -32767, 32767), dtype=np.int16)
