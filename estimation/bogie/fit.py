"""Curves and springs of a bogie from its runs: rounds of simulation, whitening, and instrumental variables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Self

import numpy as np

from estimation.bogie.curves import Curves, nodes
from estimation.bogie.equations import PARAMETERS
from estimation.bogie.parameters import BOGIE
from estimation.bogie.signals import BogieRun, placed
from estimation.bogie.simulation import Gear
from estimation.bogie.sums import UNKNOWNS, MeasuredRun, Spectra, error_spectrum, long_enough, normal, spectra
from estimation.geometry.parameters import PRIORS
from estimation.values.arrays import FloatArray, FrozenArrays
from estimation.values.quantities import jackknife_std
from estimation.values.reasons import Reason, ReasonCode
from estimation.vehicle.vehicle_class import SensorChannel, VehicleClass, VehicleParameters

FRICTION = PARAMETERS.index("inverse_friction")
GroupedRun = tuple[int, BogieRun]  # with the group of the jackknife that it belongs to


@dataclass(frozen=True, slots=True)
class Beforehand(FrozenArrays):
    """What is known of a bogie before it has run."""

    gear: Gear
    stds: Annotated[FloatArray, "p"]  # of ``PARAMETERS``

    @classmethod
    def of(cls, vehicle_class: VehicleClass) -> Self:
        """Return what the class of its vehicle says."""
        sensors, of_class = vehicle_class.sensors, vehicle_class.std_of
        assert vehicle_class.bogie is not None
        yaw, lateral, frame = map(_scale_std, (sensors.yaw, sensors.lateral, sensors.mass_lateral))
        both = frame / np.sqrt(2.0)  # of mean and half difference of two sensors
        creep = of_class("longitudinal_creep_coefficient")
        by_name = {
            "yaw_stiffness": of_class("yaw_stiffness"),
            "lateral_stiffness": of_class("lateral_stiffness"),
            "inverse_friction": BOGIE.inverse_friction_std,
            "creep": creep,
            "yaw_inertia": of_class("yaw_inertia"),
            "frame_inertia": of_class("frame_yaw_inertia"),
            "spin_creep": of_class("lateral_spin_creep_coefficient"),
            "shift": BOGIE.shift_std,
            "frame_scale": both,
            "frame_difference": both,
        }
        by_name |= {f"yaw_scale_{end}": yaw for end in ("front", "rear")}
        by_name |= {f"lateral_scale_{end}": lateral for end in ("front", "rear")}
        by_name |= {f"yaw_angle_{end}": PRIORS.mounting_std for end in ("front", "rear")}
        stds = np.array([by_name[name] for name in PARAMETERS])
        return cls(Gear(vehicle_class.parameters, vehicle_class.bogie), np.maximum(stds, PRIORS.least_scale_std))

    def information(self, bend_std: float) -> FloatArray:
        """Return the information (u, u) on the parameters, and on curves whose bends from node to node have a std."""
        b = len(nodes())
        found = np.zeros((UNKNOWNS + 2 * b, UNKNOWNS + 2 * b))
        found[np.arange(UNKNOWNS), np.arange(UNKNOWNS)] = self.stds**-2.0
        bends = np.diff(np.eye(b), 2, axis=0)
        own = (bends.T @ bends + BOGIE.held**2 * np.eye(b)) / bend_std**2
        for axle in range(2):
            part = slice(UNKNOWNS + axle * b, UNKNOWNS + (axle + 1) * b)
            found[part, part] = own
        return found


def _scale_std(channel: SensorChannel) -> float:
    return float(np.hypot(PRIORS.least_scale_std, channel.scale_std))


@dataclass(frozen=True, slots=True)
class BogieFit(FrozenArrays):
    """What the runs of a bogie give: the unknowns are the parameters of its equations, then R of both axles."""

    theta: Annotated[FloatArray, "u"]
    without: Annotated[FloatArray, "g", "u"]  # with each group of runs left out
    by_parameter: Annotated[FloatArray, "p", "u"]  # per std of what is known beforehand of each parameter
    by_law: Annotated[FloatArray, "u"]  # by what the law of creep is off, of the curves alone
    by_bends: Annotated[FloatArray, "u", "u"]  # covariance by what is known beforehand of the bends of curves
    gear: Gear  # with the friction about which the equations were linear last
    visited: Annotated[FloatArray, 2, "b"]  # m run at each node, by axle
    likeness: Annotated[FloatArray, 2]  # correlation of simulated and measured y - d, by axle
    open_std: Annotated[FloatArray, 2]  # m, of y - d by what is simulated of it, by axle
    moved: float  # m, rms by which the last round changed R where the wheelsets have been

    @property
    def replicates(self) -> FloatArray:
        """The unknowns (1 + g, u) of all runs, then with each group left out."""
        return np.concatenate([self.theta[None], self.without])

    def curve(self, axle: int) -> slice:
        """Return where R of an axle, 0 or 1, is in the unknowns."""
        b = self.visited.shape[1]
        return slice(UNKNOWNS + axle * b, UNKNOWNS + (axle + 1) * b)

    def parameter(self, *names: str) -> tuple[float, float]:
        """Return value and std of the sum of some parameters."""
        chosen = np.isin(np.arange(len(self.theta)), [PARAMETERS.index(name) for name in names]).astype(np.float64)
        sampled = float(jackknife_std(self.replicates @ chosen))
        by_prior = float(np.linalg.norm(self.by_parameter @ chosen))
        return float(self.theta @ chosen), float(np.sqrt(sampled**2 + by_prior**2 + chosen @ self.by_bends @ chosen))

    @property
    def stiffness_ratio(self) -> tuple[float, float]:
        """Yaw stiffness over creep coefficient, of that on file, and its std."""
        value, std = self.parameter("yaw_stiffness", "creep")
        return 1.0 + value, float(np.hypot(std, BOGIE.stiffness_doubt))

    @property
    def inverse_friction(self) -> tuple[float, float]:
        """1/mu and its std."""
        more, std = self.parameter("inverse_friction")
        return self.gear.inverse_friction + more, std


@dataclass(frozen=True, slots=True)
class Reached(FrozenArrays):
    """What a bogie is taken to be after some rounds."""

    gear: Gear
    curves: Curves
    theta: Annotated[FloatArray, "u"]  # the unknowns, 1/mu from that of the gear on

    @classmethod
    def at_first(cls, known: Beforehand, curves: Curves) -> Self:
        """Return what it is taken to be before any round."""
        return cls(known.gear, curves, np.concatenate([np.zeros(UNKNOWNS), curves.values.ravel()]))

    def towards(self, theta: FloatArray, blend: float) -> Reached:
        """Return what it is taken to be with a share of the way to some unknowns gone."""
        values = theta[UNKNOWNS:].reshape(2, -1)
        values = values - values[:, [values.shape[1] // 2]]  # the constant is not observable
        curves = Curves(self.curves.values + blend * (values - self.curves.values))
        friction = self.gear.inverse_friction + blend * float(theta[FRICTION])
        gear = replace(
            self.gear,
            inverse_friction=min(max(friction, 0.0), BOGIE.most_inverse_friction),
            moving=_moving(self.gear.vehicle, theta),
        )
        theta = np.concatenate([theta[:UNKNOWNS], curves.values.ravel()])
        theta[FRICTION] = 0.0
        return Reached(gear, curves, theta)

    def expected(self, known: Beforehand, bend_std: float) -> tuple[FloatArray, FloatArray]:
        """Return the information (u, u) on the unknowns beforehand, and its product (u,) with what is expected."""
        information = known.information(bend_std)
        expected = np.zeros(UNKNOWNS)
        expected[FRICTION] = BOGIE.inverse_friction - self.gear.inverse_friction
        held = BOGIE.held**2 / bend_std**2 * self.curves.values.ravel()
        return information, information[:, :UNKNOWNS] @ expected + np.concatenate([np.zeros(UNKNOWNS), held])


@dataclass(frozen=True, slots=True)
class _State:
    """Where the rounds have come to."""

    reached: Reached
    parts: tuple[Spectra, ...]


def fit_bogie(known: Beforehand, runs: Sequence[GroupedRun], start: Curves | None = None) -> BogieFit | Reason:
    """Return curves and parameters of a bogie, or why its runs do not give them.

    Args:
        start: Curves of an earlier fit: fewer rounds are needed from there.
    """
    radius = known.gear.vehicle.nominal_radius
    used = [MeasuredRun.of(group, run, radius) for group, run in runs if long_enough(run)]
    if len({of.group for of in used}) < BOGIE.fewest_groups:
        text = f"{len(used)} runs of {BOGIE.segment_m:g} m or more, {BOGIE.fewest_groups} are needed"
        return Reason(ReasonCode.TOO_FEW_BLOCKS, text)
    curves = start or Curves.straight(BOGIE.start_conicity)
    parts = _simulated(known.gear, curves, used)
    if parts is None:
        return _derailed()
    state = _State(Reached.at_first(known, curves), parts)
    found: BogieFit | None = None
    for number in range(BOGIE.rounds if start is None else BOGIE.rounds_again):
        first = start is None and number == 0
        found = _solved(known, state, BOGIE.first_bend_std if first else BOGIE.bend_std)
        if not np.isfinite(found.theta).all():
            return Reason(ReasonCode.NOT_FINITE, "the equations of the bogie do not determine its curves")
        if start is not None or number >= BOGIE.placed_from:
            pairs = zip(used, state.parts, strict=True)
            used = [replace(of, run=placed(of.run, part.followed.shift)) for of, part in pairs]
        moved = _moved_on(state, found, used, 1.0 if first else BOGIE.blend)
        if moved is None:
            return _derailed()
        state = moved
    assert found is not None
    return _checked(found)


def _simulated(gear: Gear, curves: Curves, runs: Sequence[MeasuredRun]) -> tuple[Spectra, ...] | None:
    parts = []
    for of in runs:
        part = spectra(gear, curves, of)
        if part is None:
            return None
        parts.append(part)
    return tuple(parts)


def _solved(known: Beforehand, state: _State, bend_std: float) -> BogieFit:
    reached, parts = state.reached, state.parts
    information, expected_right = reached.expected(known, bend_std)
    b = reached.curves.values.shape[1]
    visited = np.sum([part.visited for part in parts], axis=0)
    theta, groups = reached.theta, np.array([part.group for part in parts])
    numbers = np.unique(groups)
    for _ in range(BOGIE.inner_rounds):
        errors = error_spectrum(parts, theta)
        sums = [normal(part, errors.covariance, scale) for part, scale in zip(parts, errors.scale, strict=True)]
        left = np.stack([sum(one for (one, _), g in zip(sums, groups, strict=True) if g == n) for n in numbers])
        right = np.stack([sum(one for (_, one), g in zip(sums, groups, strict=True) if g == n) for n in numbers])
        whole, wanted = left.sum(axis=0) + information, expected_right - right.sum(axis=0)
        theta = np.linalg.solve(whole, wanted)
    without = np.stack([np.linalg.solve(whole - part, wanted + more) for part, more in zip(left, right, strict=True)])
    inverse = np.linalg.inv(whole)
    least = -reached.gear.inverse_friction
    theta, without = _not_below(theta, inverse, least), np.stack([_not_below(one, inverse, least) for one in without])
    change = (theta[UNKNOWNS:] - reached.theta[UNKNOWNS:]).reshape(2, b)
    change -= change[:, [b // 2]]
    moved = float(np.sqrt(np.average(change**2, weights=np.maximum(visited, 1e-9))))
    likeness = np.mean([part.followed.likeness for part in parts], axis=0)
    open_std = np.sqrt(np.mean([part.followed.open_std**2 for part in parts], axis=0))
    by_curves = inverse[:, UNKNOWNS:]
    return BogieFit(
        theta,
        without,
        _by_parameter(inverse, known.stds),
        _by_law(whole),
        by_curves @ information[UNKNOWNS:, UNKNOWNS:] @ by_curves.T,
        reached.gear,
        visited,
        likeness,
        open_std,
        moved,
    )


def _by_parameter(inverse: FloatArray, stds: FloatArray) -> FloatArray:
    """Return the changes (p, u) of the unknowns per std of what is known beforehand of each parameter.

    What data say of 1/mu beside the curves hangs on how creep saturates; they are not believed beyond its doubt.
    """
    found = inverse[:, :UNKNOWNS].T / stds[:, None]
    found[FRICTION] = BOGIE.friction_doubt * inverse[:, FRICTION] / inverse[FRICTION, FRICTION]
    return np.asarray(found)


def _by_law(whole: FloatArray) -> FloatArray:
    """Return the change (u,) of the curves where creep saturates otherwise than its law says; springs stay.

    By friction as rails have it, not as it is found: what saturates by another law is taken for softer creep.
    """
    change, curves = np.zeros(len(whole)), slice(UNKNOWNS, None)
    per_friction = np.linalg.solve(whole[curves, curves], whole[curves, FRICTION])
    change[curves] = BOGIE.law_doubt * BOGIE.inverse_friction * per_friction
    return change


def _not_below(theta: FloatArray, inverse: FloatArray, least: float) -> FloatArray:
    """Return unknowns with 1/mu not below 0: what they are where it is 0, if they have less."""
    excess = max(least - float(theta[FRICTION]), 0.0)
    return np.asarray(theta + inverse[:, FRICTION] / inverse[FRICTION, FRICTION] * excess)


def _moved_on(state: _State, found: BogieFit, runs: Sequence[MeasuredRun], blend: float) -> _State | None:
    """Return the next round's start; a change after which the bogie derails is halved. None where it still does."""
    for _ in range(BOGIE.halvings):
        reached = state.reached.towards(found.theta, blend)
        parts = _simulated(reached.gear, reached.curves, runs)
        if parts is not None:
            return _State(reached, parts)
        blend *= 0.5
    return None


def _moving(on_file: VehicleParameters, theta: FloatArray) -> VehicleParameters:
    """Return the parameters of a vehicle as they were found."""
    found = dict(zip(PARAMETERS, np.maximum(1.0 + theta[:UNKNOWNS], BOGIE.least_share), strict=True))
    return replace(
        on_file,
        longitudinal_creep_coefficient=on_file.longitudinal_creep_coefficient / found["creep"],
        lateral_creep_coefficient=on_file.lateral_creep_coefficient / found["creep"],
        yaw_stiffness=on_file.yaw_stiffness * found["yaw_stiffness"],
        lateral_stiffness=on_file.lateral_stiffness * found["lateral_stiffness"],
    )


def _derailed() -> Reason:
    return Reason(
        ReasonCode.MOTION_UNEXPLAINED,
        "a bogie of the vehicle's class with the curves that its motion shows does not stay on this track;"
        " check class, track and sensors",
    )


def _checked(found: BogieFit) -> BogieFit | Reason:
    least = float(found.likeness.min())
    if least >= BOGIE.least_likeness:
        return found
    return Reason(
        ReasonCode.MOTION_UNEXPLAINED,
        f"the motion of a wheelset and that of its bogie simulated over the track have a correlation of {least:.2f},"
        f" {BOGIE.least_likeness:g} is needed; check class, track, positions and sensors",
    )
