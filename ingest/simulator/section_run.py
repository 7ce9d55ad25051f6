"""A simulated section as an estimator meets it: windows with positions as measured; and beside them the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from estimation.contact.conicity import equivalent_conicity, nonlinearity_parameter, zero_crossing
from estimation.errors import NotFoundError
from estimation.track.panel.measured_curves import MeasuredCurve
from estimation.values.arrays import BoolArray, FloatArray, frozen_array
from estimation.values.quantities import Status
from estimation.values.track import TrackAlignment
from estimation.values.windows import Window, WindowQuality
from estimation.vehicle.equations_of_motion import VehicleParameters
from ingest.simulator.motion import travelled
from ingest.simulator.section_scenario import ProfilePair, SectionScenario
from ingest.simulator.section_simulation import (
    POSITION,
    PROFILES,
    RawCounts,
    Resolution,
    axle_start,
    ensure_simulated,
    journey_speed,
    section_track,
    stream,
    vehicle_parameters,
    wheelset_file,
)
from ingest.simulator.track import TrackTruth

SECTION = "S"
WINDOW_S = 60.0
PROFILE_STD = 0.1e-3  # m of y - d that follows from measured profiles
AMPLITUDES = tuple(float(a) for a in np.arange(4, 13) * 0.25e-3)  # m: 1.0 to 3.0 mm
NANOSECONDS = 1_000_000_000
_FIRST_NS = 1_710_720_000 * NANOSECONDS
_DAY_NS = 86_400 * NANOSECONDS
_HOUR_NS = 3_600 * NANOSECONDS


@dataclass(frozen=True, slots=True)
class WheelsetTruth:
    """The true geometry of a wheelset at nominal gauge, and where it runs."""

    number: int  # from 0
    serial: str
    vehicle: str
    axle: int  # from 1
    displacement: FloatArray  # (n,) m, y - d
    difference: FloatArray  # (n,) m, rL - rR
    radius_sum: FloatArray  # (n,) m
    angle_sum: FloatArray  # (n,) rad
    angle_difference: FloatArray  # (n,) rad
    amplitude: FloatArray  # (k,) m
    conicity: FloatArray  # (k,)
    nonlinearity: float  # 1/mm
    zero_crossing: float  # m
    parameters: VehicleParameters  # of its vehicle, as simulated

    def __post_init__(self) -> None:
        n, k = len(self.displacement), len(self.amplitude)
        for name in ("displacement", "difference", "radius_sum", "angle_sum", "angle_difference"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (n,), name=name))
        for name in ("amplitude", "conicity"):
            object.__setattr__(self, name, frozen_array(getattr(self, name), (k,), name=name))


@dataclass(frozen=True, slots=True)
class PositionError:
    """Measured position = true + offset + scale (true - middle of the section), of one journey."""

    offset: float  # m
    scale: float


@dataclass(frozen=True, slots=True)
class SectionRun:
    """Everything of one seed of a section scenario. Windows are read when asked for."""

    scenario: SectionScenario
    seed: int
    folder: Path
    pair: ProfilePair
    track: TrackTruth  # beyond the section at both ends
    wheelsets: tuple[WheelsetTruth, ...]

    def truth(self, serial: str) -> WheelsetTruth:
        """Return the truth of one wheelset.

        Raises
        ------
        NotFoundError
            No such wheelset.
        """
        for item in self.wheelsets:
            if item.serial == serial:
                return item
        raise NotFoundError("wheelset", serial)

    def position_error(self, vehicle: int, journey: int) -> PositionError:
        """Return the position error of ``vehicle`` (from 0) on ``journey``."""
        offset, scale = stream(self.seed, POSITION, vehicle, journey).uniform(-1.0, 1.0, 2)
        return PositionError(self.scenario.position_offset * offset, self.scenario.position_scale * scale)

    def windows(self, serial: str) -> Iterator[Window]:
        """Yield the windows of one wheelset, journey by journey; what lies off the section is not valid.

        Raises
        ------
        NotFoundError
            No such wheelset.
        """
        truth = self.truth(serial)
        with np.load(wheelset_file(self.folder, truth.number)) as stored:
            for journey in range(self.scenario.passes):
                yield from self._journey(truth, journey, stored[f"counts_{journey}"])

    def all_windows(self) -> Iterator[Window]:
        """Yield the windows of all wheelsets."""
        for truth in self.wheelsets:
            yield from self.windows(truth.serial)

    def known_track(self) -> TrackAlignment | None:
        """Return the true alignment as a recording of the section, where the scenario says that it is known."""
        return self.true_track() if self.scenario.alignment_known else None

    def known_gauge(self) -> TrackAlignment | None:
        """Return the gauge alone, alignment all NaN, where the scenario says that it is known and varies."""
        if not (self.scenario.gauge_known and self.scenario.gauge_std > 0.0):
            return None
        track = self.true_track()
        unknown = np.full(len(track.s), np.nan)
        return replace(track, alignment=unknown, alignment_std=unknown)

    def measured(self) -> dict[str, MeasuredCurve]:
        """Return what the measured profiles say of the first ``wheelsets_measured``, stretched by an error."""
        found = {}
        for truth in self.wheelsets[: self.scenario.wheelsets_measured]:
            R = np.maximum.accumulate(truth.difference)
            first = np.concatenate([[True], np.diff(R) > 0.0])
            difference, displacement = R[first], truth.displacement[first]
            exact = MeasuredCurve(
                truth.serial, difference, displacement - np.interp(0.0, difference, displacement), PROFILE_STD
            )
            error = stream(self.seed, PROFILES, truth.number).normal(0.0, PROFILE_STD / exact.spread)
            found[truth.serial] = replace(exact, displacement=(1.0 + error) * exact.displacement)
        return found

    def true_track(self) -> TrackAlignment:
        """Return the true alignment of the section, with the gauge where the scenario says that it is known."""
        on = (self.track.s >= 0.0) & (self.track.s <= self.scenario.length)
        n = int(on.sum())
        gauge_known = self.scenario.gauge_known or self.scenario.gauge_std == 0.0
        return TrackAlignment(
            section=SECTION,
            version=1,
            s=self.track.s[on],
            alignment=self.track.alignment[on],
            alignment_std=np.zeros(n),
            gauge_deviation=self.track.gauge_deviation[on] if gauge_known else np.zeros(n),
            gauge_deviation_std=np.full(n, 0.0 if gauge_known else self.scenario.gauge_std),
            passes=np.zeros(n, dtype=np.int64),
            status=Status.ESTIMATED,
            gauge_known=gauge_known,
        )

    def _journey(self, truth: WheelsetTruth, journey: int, counts: RawCounts) -> Iterator[Window]:
        scenario, resolution = self.scenario, Resolution.of_the_bus()
        vehicle = truth.number % scenario.vehicles
        speed, run = _course(scenario, self.seed, vehicle, journey)
        true = run + axle_start(truth.axle - 1)
        error = self.position_error(vehicle, journey)
        distance = true + error.offset + error.scale * (true - 0.5 * scenario.length)
        values = counts * np.array(resolution.accelerations)
        rate = scenario.sensors.rate_hz
        n = round(WINDOW_S * rate)
        start_ns = _FIRST_NS + journey * _DAY_NS + vehicle * _HOUR_NS
        for k, first in enumerate(range(0, len(values), n)):
            part = slice(first, first + n)
            window = _window(values[part], speed[part], distance[part], scenario.length, n)
            lateral, yaw, roll, mass = window.accelerations
            yield Window(
                wheelset=truth.serial,
                vehicle=truth.vehicle,
                axle=truth.axle,
                start_ns=start_ns + round(k * WINDOW_S) * NANOSECONDS,
                length_ns=round(WINDOW_S) * NANOSECONDS,
                sample_interval_s=1.0 / rate,
                lateral_acceleration=lateral,
                yaw_acceleration=yaw,
                roll_acceleration=roll,
                mass_lateral_acceleration=mass,
                speed=window.speed,
                distance=window.distance,
                valid=window.valid,
                resolution=resolution.accelerations,
                track_section=SECTION,
                odometer_m=1e5 * (1 + journey) + float(distance[first]),
                quality=_quality(window.valid, speed[part], rate),
            )


@lru_cache(maxsize=64)  # some megabytes each; the wheelsets of a vehicle share it
def _course(scenario: SectionScenario, seed: int, vehicle: int, journey: int) -> tuple[FloatArray, FloatArray]:
    """Return speed, as the bus carries it, and distance run (n,) at the samples of the sensors."""
    resolution, stride = Resolution.of_the_bus(), scenario.sensors.stride
    speed = journey_speed(scenario, seed, vehicle, journey)
    counted = np.rint(speed[::stride] / resolution.speed) * resolution.speed
    run = travelled(speed, 0.0)[::stride]
    return frozen_array(counted, (len(counted),), name="speed"), frozen_array(run, (len(run),), name="distance")


@dataclass(frozen=True, slots=True)
class _Filled:
    """A window's arrays at full length."""

    accelerations: FloatArray  # (4, n)
    speed: FloatArray  # (n,)
    distance: FloatArray  # (n,)
    valid: BoolArray  # (n,)


def _window(values: FloatArray, speed: FloatArray, distance: FloatArray, length: float, n: int) -> _Filled:
    """Return arrays of length ``n``: NaN where the recording has ended, or the wheelset is off the section."""
    count = len(values)
    on = np.zeros(n, dtype=np.bool_)
    on[:count] = (distance >= 0.0) & (distance <= length)
    padded = np.full((6, n), np.nan)
    padded[:4, :count], padded[4, :count], padded[5, :count] = values.T, speed, distance
    padded[:4, ~on] = np.nan
    padded[5, ~on] = np.nan
    return _Filled(padded[:4], padded[4], padded[5], on)


def _quality(valid: BoolArray, speed: FloatArray, rate_hz: int) -> WindowQuality:
    edges = np.flatnonzero(np.diff(np.concatenate([[True], valid, [True]]).astype(np.int8)))
    gaps = edges[1::2] - edges[::2]
    return WindowQuality(
        coverage=float(valid.mean()),
        longest_gap_s=float(gaps.max(initial=0)) / rate_hz,
        gaps=len(gaps),
        clipped=0.0,
        invalid=0.0,
        speed_min_m_s=float(speed.min()),
        speed_max_m_s=float(speed.max()),
        position_quality=1.0,
        sensor_fault=False,
    )


def simulate_section(
    scenario: SectionScenario,
    seed: int,
    folder: Path,
    *,
    workers: int = 2,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> SectionRun:
    """Return one seed of a scenario; its simulation is read from ``folder`` where it was made before.

    Parameters, errors: as ``section_simulation.ensure_simulated``.
    """
    made = ensure_simulated(scenario, seed, folder, workers=workers, progress=progress)
    truths = tuple(_truth(scenario, seed, number, made) for number in range(scenario.vehicles * scenario.wheelsets))
    return SectionRun(scenario, seed, made, scenario.pair(seed), section_track(scenario, seed), truths)


def _truth(scenario: SectionScenario, seed: int, number: int, folder: Path) -> WheelsetTruth:
    vehicle = number % scenario.vehicles
    with np.load(wheelset_file(folder, number)) as stored:
        x, R = stored["displacement"], stored["difference"]
        return WheelsetTruth(
            number=number,
            serial=f"W{number:02d}",
            vehicle=f"V{vehicle}",
            axle=number // scenario.vehicles + 1,
            displacement=x,
            difference=R,
            radius_sum=stored["radius_sum"],
            angle_sum=stored["angle_sum"],
            angle_difference=stored["angle_difference"],
            amplitude=np.array(AMPLITUDES),
            conicity=equivalent_conicity(x, R, AMPLITUDES),
            nonlinearity=nonlinearity_parameter(x, R),
            zero_crossing=zero_crossing(x, R),
            parameters=vehicle_parameters(scenario, seed, vehicle),
        )
