"""Parameters of the motion."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Self

from estimation.errors import ParameterError
from estimation.vehicle.equations_of_motion import VehicleParameters
from estimation.vehicle.vehicle_class import VehicleClass, usable_cutoff


@dataclass(frozen=True, slots=True)
class SignalParameters:
    """How windows become motion."""

    cutoff_wavelength: float = 40.0  # m; of longer ones less than half is left
    bridged_samples: int = 3  # gaps up to this long are bridged for the integrals, never used as samples
    modelled_gap_s: float = 0.25  # gaps up to this long do not end a segment of motion: their integrals are solved for
    gap_margin_s: float = 0.5  # on both sides of a modelled gap, where that takes some of the motion too
    shortest_segment_s: float = 10.0
    trimmed_s: float = 1.0  # at each end of a segment, where the high-pass sees one side only
    least_speed_m_s: float = 8.0
    sharpest_curvature: float = 5e-5  # 1/m: shifts the wheelset by a third of a bin at conicity 0.2
    highest_cant: float = 0.02  # m
    curve_margin: float = 30.0  # m kept from sharper curves; positions and registers are off by some
    max_cant_deficiency_change: float = 0.1  # m/s2, of the slow lateral acceleration; drift on straight is less
    least_used: float = 0.1  # of a window's samples
    block_s: float = 20.0

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if not value >= 0:
                raise ParameterError(f"{value!r} is negative", field=item.name)
        if not self.cutoff_wavelength > 0:
            raise ParameterError("must be positive", field="cutoff_wavelength")

    @property
    def source(self) -> str:
        """Where the motion of a bin table came from, for its key."""
        return "band-limited " + " ".join(f"{item.name}={getattr(self, item.name)}" for item in fields(self))


@dataclass(frozen=True, slots=True)
class Gates:
    """When a window may be estimated at all."""

    least_coverage: float = 0.25
    most_clipped: float = 0.1  # clipped samples are left out; with more than this the window is refused
    most_clipped_in_blows: float = 0.002  # the same of a wheel with a flat: some in every turn leave nothing whole
    least_position_quality: float = 0.1


@dataclass(frozen=True, slots=True)
class WindowParameters:
    """What turns a window into motion: the class of its vehicle, the filters, and the gates.

    The nominal radius of ``vehicle_class`` is that of the wheelset of the window.
    """

    vehicle_class: VehicleClass
    signals: SignalParameters = field(default_factory=SignalParameters)
    gates: Gates = field(default_factory=Gates)

    @classmethod
    def of(
        cls, vehicle_class: VehicleClass, nominal_radius: float | None, signals: SignalParameters, gates: Gates
    ) -> Self:
        """Return the parameters of a wheelset; the cut-off wavelength is one at which sensors see more than noise."""
        if nominal_radius is not None:
            own = replace(vehicle_class.parameters, nominal_radius=nominal_radius)
            vehicle_class = replace(vehicle_class, parameters=own)
        cutoff = usable_cutoff(vehicle_class, signals.cutoff_wavelength)
        return cls(vehicle_class, replace(signals, cutoff_wavelength=cutoff), gates)

    @property
    def vehicle(self) -> VehicleParameters:
        """Parameters of the wheelset and its suspension."""
        return self.vehicle_class.parameters
