"""What the sensors of a class can see of the contact geometry, and with what std: by linear response, before mounting.

The alignment drives the linear model; the equations of the wheelset are solved for the combinations by least squares,
as the estimator does: the yaw equation for rL - rR and dL + dR, the lateral one for rL + rR and dL - dR. To first
order, noise and wrong parameters then give

    delta theta = -(X'X)^-1 X' delta e,   X = de/dtheta,   X'X = Re integral of S_d X* X df

Noise in the regressors also pulls them down however long the vehicle runs (regression dilution, to second order; that
of the alignment is left out: the estimator corrects it). Beside it stands the Cramer-Rao bound, where all parameters
are learnt together from both equations, with their stds beforehand (S. M. Kay, "Fundamentals of Statistical Signal
Processing: Estimation Theory", 1993, Chapters 3 and 15).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace

import numpy as np

from estimation.values.arrays import FloatArray
from estimation.vehicle.linear_model import (
    SENSORS,
    Combinations,
    ComplexArray,
    LinearContact,
    combinations,
    equations,
    filtered,
    linear_model,
    sensor_filters,
    true_signals,
)
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import VehicleClass, VehicleParameters

CAUSES = ("noise", "dilution", "track", "creep", "stiffness", "mass", "lengths", "scale")
SCALE_OF = "scale of "  # and the name of a sensor
_LENGTHS = frozenset({"nominal_radius", "half_contact_distance", "wheelbase"})
_UNITS: Mapping[str, float] = {  # of the columns of theta: one unit of each is about as large as the value
    "conicity": 0.1,
    "radius_sum_deviation": 1e-3,
    "angle_slope": 10.0,
    "angle_sum": 0.1,
}


@dataclass(frozen=True, slots=True)
class Running:
    """How the vehicle runs, and on what."""

    speed: float = 20.0  # m/s
    contact: LinearContact = field(default_factory=LinearContact)
    duration: float = 600.0  # s
    alignment_rms: float = 1e-3  # m, in the band
    alignment_std: float = 1e-4  # m, in the band: how well the alignment is known
    wavelengths: tuple[float, float] = (2.5, 40.0)  # m; the longer one is the filter's cut-off

    @property
    def frequencies_hz(self) -> FloatArray:
        """(f,) of the band, Hz."""
        short, long = self.wavelengths
        return np.geomspace(self.speed / long, self.speed / short, VEHICLE.frequencies)

    @property
    def alignment_density(self) -> FloatArray:
        """(f,) one-sided spectral density of the alignment, m2/Hz, with the shape of ORE B176."""
        # 1 / ((W^2 + Wr^2) (W^2 + Wc^2)) of the wave number W, Wr = 0.0206 rad/m, Wc = 0.8246 rad/m
        f = self.frequencies_hz
        square = (2 * np.pi * f / self.speed) ** 2
        shape = 1.0 / ((square + 0.0206**2) * (square + 0.8246**2))
        return np.asarray(self.alignment_rms**2 * shape / np.trapezoid(shape, f))


@dataclass(frozen=True, slots=True)
class Observed:
    """A quantity, and the std with which it is found."""

    name: str
    unit: str
    value: float
    std_by_cause: Mapping[str, float]
    bound: float  # Cramer-Rao, where all parameters are learnt too

    @property
    def std(self) -> float:
        """Standard deviation from all causes."""
        return math.hypot(*self.std_by_cause.values())

    @property
    def seen(self) -> bool:
        """Whether the std is below a quarter of the value."""
        return self.std < VEHICLE.seen_std_share * abs(self.value)


def observability(vehicle_class: VehicleClass, running: Running) -> tuple[Observed, ...]:
    """Return what is seen of the front wheelset: the four combinations and the primary yaw stiffness."""
    # conicity stands twice: with the yaw stiffness of the class, and where the data alone give the yaw stiffness; there
    # dL + dR, which turns a single wheelset exactly as the yaw spring does, is that of the contact geometry
    sensitivity = _sensitivity(vehicle_class, running)
    bounds = _bounds(sensitivity)
    yaw = _by_cause(sensitivity, 1, ("conicity", "angle_sum"), ())
    learnt = _by_cause(sensitivity, 1, ("conicity", "yaw_stiffness"), ("yaw_stiffness",))
    lateral = _by_cause(sensitivity, 0, ("radius_sum_deviation", "angle_slope"), ())
    at, stiffness = sensitivity.at, vehicle_class.parameters.yaw_stiffness
    rows = (  # name, unit, value, unit of theta in unit of the row, std by cause, name of theta
        ("rL - rR, as conicity", "", at.conicity, 1.0, yaw, "conicity"),
        ("  with the yaw stiffness learnt", "", at.conicity, 1.0, learnt, "conicity"),
        ("rL + rR", "mm", 1.0, 1e3, lateral, "radius_sum_deviation"),
        (
            "dL - dR at 3 mm",
            "mrad",
            1e3 * VEHICLE.lateral_amplitude * at.angle_slope,
            1e3 * VEHICLE.lateral_amplitude,
            lateral,
            "angle_slope",
        ),
        ("dL + dR", "mrad", 1e3 * at.angle_sum, 1e3, yaw, "angle_sum"),
        ("primary yaw stiffness", "MN m/rad", 1e-6 * stiffness, 1e-6 * stiffness, learnt, "yaw_stiffness"),
    )
    return tuple(
        Observed(name, unit, value, {cause: scale * std[cause][key] for cause in CAUSES}, scale * bounds[key])
        for name, unit, value, scale, std, key in rows
    )


def conicity_shifts(vehicle_class: VehicleClass, running: Running) -> Mapping[str, tuple[float, float]]:
    """Return by how much the conicity shifts where a parameter on file, or the scale of a sensor, is too large.

    Per unit of relative error, of the front wheelset; the first number with the yaw stiffness of the class, the second
    where the data alone give it. The names are fields of the class, and ``scale of lateral``, ... of the sensors.
    """
    sensitivity = _sensitivity(vehicle_class, running)
    errors = sensitivity.by_error

    def shifts(theta: tuple[str, ...], learnt: tuple[str, ...]) -> dict[str, float]:
        _, weighted, inverse = _least_squares(sensitivity, 1, theta, learnt)
        return {
            name: 0.0 if name in learnt else float(-(inverse @ (weighted.T @ change[:, 1]).real)[0])
            for name, change in errors.items()
        }

    held = shifts(("conicity", "angle_sum"), ())
    learnt = shifts(("conicity", "yaw_stiffness"), ("yaw_stiffness",))
    return {name: (held[name], learnt[name]) for name in errors}


@dataclass(frozen=True, slots=True)
class _Sensitivity:
    """Derivatives of e (f, 2) per metre of alignment, and the spectral densities of what is random."""

    at: Combinations
    by_combination: Mapping[str, ComplexArray]
    by_error: Mapping[str, ComplexArray]  # by the logarithm of each parameter, then by the scale of each sensor
    std: Mapping[str, float]  # relative, of these
    noise: ComplexArray  # (f, 2, 2) of sensors, of e
    sensed: Mapping[str, ComplexArray]  # (f, 2, sensors), what the noise of each sensor makes of the derivatives
    sensed_error: ComplexArray  # (f, 2, sensors), and of e
    noise_density: FloatArray  # (sensors,) squared
    weights: FloatArray  # (f,) of the integral over frequency
    track: ComplexArray  # (f, 2, 2) of the alignment's std, of e
    density: FloatArray  # (f,) of the alignment, weights of the integral over frequency included
    duration: float


def _sensitivity(vehicle_class: VehicleClass, running: Running) -> _Sensitivity:
    p, layout = vehicle_class.parameters, vehicle_class.sensors
    wheelbase = None if vehicle_class.bogie is None else vehicle_class.bogie.wheelbase
    f = running.frequencies_hz
    s = (2j * np.pi * f).astype(np.complex128)
    at = combinations(running.contact)
    u = true_signals(linear_model(vehicle_class, running.speed, running.contact), running.contact, p, s)
    E = filtered(equations(p, wheelbase, running.speed, at), s)

    by_combination, by_parameter = _derivatives(p, wheelbase, running.speed, at, s)
    moved = {name: (change @ u[:, :, None])[:, :, 0] for name, change in (by_combination | by_parameter).items()}
    measured, restored = sensor_filters(layout, s)
    through = E @ restored  # (f, 2, sensors)
    raw = (measured @ u[:, :, None])[:, :, 0]
    channels = layout.channels
    of_sensor = {name: channels[name.removeprefix("other_")] for name in SENSORS}
    densities = np.array([max(of_sensor[name].noise_density, VEHICLE.least_noise_density) ** 2 for name in SENSORS])
    known = (running.alignment_std / running.alignment_rms) ** 2 * running.alignment_density
    by_track = E[:, :, -1]  # the alignment enters x alone
    return _Sensitivity(
        at=at,
        by_combination={name: moved[name] for name in by_combination},
        by_error={name: moved[name] for name in by_parameter}
        | {f"{SCALE_OF}{name}": through[:, :, n] * raw[:, n, None] for n, name in enumerate(SENSORS)},
        std={name: vehicle_class.std_of(name) for name in by_parameter}
        | {f"{SCALE_OF}{name}": of_sensor[name].scale_std for name in SENSORS},
        noise=np.asarray((through * densities) @ through.conj().transpose(0, 2, 1)),
        sensed={name: change @ restored for name, change in (by_combination | by_parameter).items()},
        sensed_error=through,
        noise_density=densities,
        weights=_weights(f),
        track=np.asarray(known[:, None, None] * by_track[:, :, None] * by_track.conj()[:, None, :]),
        density=running.alignment_density * _weights(f),
        duration=running.duration,
    )


def _derivatives(
    p: VehicleParameters, wheelbase: float | None, speed: float, at: Combinations, s: ComplexArray
) -> tuple[dict[str, ComplexArray], dict[str, ComplexArray]]:
    """Return the derivatives of E (f, 2, signals) by the combinations, and by the logarithms of the parameters."""
    E, relative = equations(p, wheelbase, speed, at), VEHICLE.derivative_step

    def change(changed: FloatArray, step: float) -> ComplexArray:
        return filtered((changed - E) / step, s)

    names = [item.name for item in fields(VehicleParameters) if getattr(p, item.name)]
    by_parameter = {
        name: change(equations(replace(p, **{name: (1 + relative) * getattr(p, name)}), wheelbase, speed, at), relative)
        for name in names
    }
    if wheelbase is not None:
        by_parameter["wheelbase"] = change(equations(p, (1 + relative) * wheelbase, speed, at), relative)
    by_combination = {}
    for name, unit in _UNITS.items():
        moved = replace(at, **{name: getattr(at, name) + relative * unit})
        by_combination[name] = change(equations(p, wheelbase, speed, moved), relative * unit)
    return by_combination, by_parameter


def _by_cause(
    sensitivity: _Sensitivity, equation: int, theta: tuple[str, ...], learnt: tuple[str, ...]
) -> dict[str, dict[str, float]]:
    X, weighted, inverse = _least_squares(sensitivity, equation, theta, learnt)
    variances: dict[str, FloatArray] = {}
    for cause, spectrum in (("noise", sensitivity.noise), ("track", sensitivity.track)):
        middle = ((weighted * spectrum[:, equation, equation].real[:, None]).T @ X).real / (2 * sensitivity.duration)
        variances[cause] = np.diag(inverse @ middle @ inverse)
    variances["dilution"] = _dilution(sensitivity, equation, theta, (weighted.T @ X).real) ** 2
    for cause in CAUSES[3:]:
        variances[cause] = np.zeros(len(theta))
    for name, change in sensitivity.by_error.items():
        if name not in learnt:
            shift = sensitivity.std[name] * inverse @ (weighted.T @ change[:, equation]).real
            variances[_cause_of(name)] = variances[_cause_of(name)] + shift**2
    return {
        cause: dict(zip(theta, np.sqrt(np.maximum(values, 0.0)).tolist(), strict=True))
        for cause, values in variances.items()
    }


def _least_squares(
    sensitivity: _Sensitivity, equation: int, theta: tuple[str, ...], learnt: tuple[str, ...]
) -> tuple[ComplexArray, ComplexArray, FloatArray]:
    columns = {**sensitivity.by_combination, **{name: sensitivity.by_error[name] for name in learnt}}
    X = np.stack([columns[name][:, equation] for name in theta], axis=1)
    weighted = X.conj() * sensitivity.density[:, None]
    return X, weighted, _inverse((weighted.T @ X).real)


def _dilution(sensitivity: _Sensitivity, equation: int, theta: tuple[str, ...], information: FloatArray) -> FloatArray:
    regressors = np.stack([sensitivity.sensed[name][:, equation] for name in theta], axis=1)  # (f, k, sensors)
    weighted = regressors.conj() * sensitivity.noise_density * sensitivity.weights[:, None, None]
    noisy = np.einsum("fjs,fks->jk", weighted, regressors).real
    with_error = np.einsum("fjs,fs->j", weighted, sensitivity.sensed_error[:, equation]).real
    return np.asarray(_inverse(information + noisy) @ with_error)


def _bounds(sensitivity: _Sensitivity) -> dict[str, float]:
    changes = {**sensitivity.by_combination, **sensitivity.by_error}
    prior = [VEHICLE.angle_sum_std if name == "angle_sum" else math.inf for name in sensitivity.by_combination]
    prior += sensitivity.std.values()
    J = np.stack(list(changes.values()), axis=2)  # (f, 2, names)
    weighted = np.linalg.solve(sensitivity.noise + sensitivity.track, J * sensitivity.density[:, None, None])
    information = 2 * sensitivity.duration * np.einsum("fej,fek->jk", J.conj(), weighted).real
    free = [n for n, std in enumerate(prior) if std > VEHICLE.certain_std]
    names, prior = [list(changes)[n] for n in free], [prior[n] for n in free]
    information = information[np.ix_(free, free)]

    def std_of(name: str) -> float:
        known = np.array([0.0 if item == name else std**-2 for item, std in zip(names, prior, strict=True)])
        return math.sqrt(_inverse(information + np.diag(known))[names.index(name), names.index(name)])

    wanted = (*sensitivity.by_combination, "yaw_stiffness")
    return {name: std_of(name) if name in names else 0.0 for name in wanted}


def _cause_of(name: str) -> str:
    if name.startswith(SCALE_OF):
        return "scale"
    if name.endswith("_coefficient"):
        return "creep"
    if name.endswith(("_stiffness", "_damping")):
        return "stiffness"
    return "lengths" if name in _LENGTHS else "mass"


def _inverse(matrix: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix * np.outer(scale, scale)) * np.outer(scale, scale))


def _weights(f: FloatArray) -> FloatArray:
    steps = np.diff(f)
    return np.asarray(0.5 * (np.append(steps, 0.0) + np.insert(steps, 0, 0.0)))
