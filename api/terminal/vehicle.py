"""Vehicle classes as text: the list of the shipped ones, and the report of a check."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

from estimation.vehicle.linear_model import LinearContact, critical_speed, klingel_wavelength, linear_model, modes
from estimation.vehicle.observability import CAUSES, Running, conicity_shifts, observability
from estimation.vehicle.parameters import VEHICLE
from estimation.vehicle.vehicle_class import VehicleClass
from ingest.vehicle_class_schema import read_vehicle_class, shipped_class, shipped_classes

CONICITIES = 0.1, 0.2, 0.3, 0.4
ERROR, SCALE_ERROR = 0.1, 0.01
LEAST_SHIFT = 5e-5  # of a conicity, that is printed


def named_class(name: str) -> VehicleClass:
    """Return the class of a file, or a shipped one."""
    path = Path(name)
    return shipped_class(name) if name in shipped_classes() and not path.is_file() else read_vehicle_class(path)


def check_report(vehicle_class: VehicleClass, speed: float, conicity: float) -> str:
    """Return modes, critical speeds, and what the sensors see."""
    contact = LinearContact(conicity)
    running = Running(speed=speed, contact=contact)
    lines = [
        f"{vehicle_class.code}: {vehicle_class.name} ({vehicle_class.arrangement})",
        f"source: {vehicle_class.source}",
        "",
        *_modes(vehicle_class, running),
        "",
        *_critical_speeds(vehicle_class),
        "",
    ]
    if any(mode.growth > 0.0 for mode in modes(linear_model(vehicle_class, speed, contact))):
        lines.append(
            "A mode grows: the vehicle hunts at this speed and conicity, and nothing is estimated while it does."
        )
    else:
        lines += _observability(vehicle_class, running)
    return "\n".join(lines)


def _modes(vehicle_class: VehicleClass, running: Running) -> Iterator[str]:
    wavelength = klingel_wavelength(vehicle_class.parameters, running.contact)
    yield f"Modes at {running.speed:g} m/s, conicity {running.contact.conicity:g}"
    yield f"  {'mode':<30}{'Hz':>8}{'damping':>10}{'growth, 1/s':>14}"
    for mode in modes(linear_model(vehicle_class, running.speed, running.contact)):
        yield f"  {mode.name:<30}{mode.frequency_hz:>8.2f}{mode.damping_ratio:>10.3f}{mode.growth:>14.2f}"
    yield f"A free wheelset would run in waves of {wavelength:.1f} m, {running.speed / wavelength:.2f} Hz."


def _critical_speeds(vehicle_class: VehicleClass) -> Iterator[str]:
    yield "Critical speed"
    for conicity in CONICITIES:
        speed = critical_speed(vehicle_class, LinearContact(conicity))
        critical = f"above {VEHICLE.highest_speed:g} m/s" if math.isinf(speed) else f"{speed:.0f} m/s"
        yield f"  conicity {conicity:g}: {critical}"


def _observability(vehicle_class: VehicleClass, running: Running) -> Iterator[str]:
    minutes, rms, std = running.duration / 60, 1e3 * running.alignment_rms, 1e3 * running.alignment_std
    yield f"What the sensors see in {minutes:g} minutes on {rms:g} mm rms of alignment, known to {std:g} mm (std)"
    yield f"  {'':<33}{'value':>8}{'std':>9}{'bound':>9}  {'unit':<9}seen"
    rows = observability(vehicle_class, running)
    for row in rows:
        seen = "yes" if row.seen else "no"
        yield f"  {row.name:<33}{row.value:>8.3g}{row.std:>9.2g}{row.bound:>9.2g}  {row.unit:<9}{seen}"
    yield ""
    yield "The std by its cause: noise, what it takes off the regressors, the track, and the stds of the class"
    yield f"  {'':<33}" + "".join(f"{cause:>10}" for cause in CAUSES)
    for row in rows:
        yield f"  {row.name:<33}" + "".join(f"{row.std_by_cause[cause]:>10.2g}" for cause in CAUSES)
    yield ""
    yield f"Shift of the conicity: a parameter on file {ERROR:.0%} too large, the scale of a sensor {SCALE_ERROR:.0%}"
    yield f"  {'':<33}{'stiffness on file':>20}{'learnt':>10}"
    for name, shifts in conicity_shifts(vehicle_class, running).items():
        error = SCALE_ERROR if name.startswith("scale of") else ERROR
        held, learnt = (round(error * shift, 4) + 0.0 for shift in shifts)  # no -0.0000
        if max(abs(held), abs(learnt)) >= LEAST_SHIFT:
            yield f"  {name:<33}{held:>20.4f}{learnt:>10.4f}"
