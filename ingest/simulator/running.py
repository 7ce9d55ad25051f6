"""How the vehicles of a scenario run: creep and friction, wheels, traction, and what the track adds to its line."""

from __future__ import annotations

from dataclasses import dataclass, field

from ingest.simulator.blows import TrackBlows, WheelFlat
from ingest.simulator.creep_laws import Creep, CreepLaw
from ingest.simulator.irregularity import Waves

CONTACT_STEP = 0.05e-3  # m of lateral displacement between the points of a contact table


@dataclass(frozen=True, slots=True)
class FrictionPlan:
    """The coefficient of friction: drawn smoothly between two limits along the section, and by campaign."""

    lowest: float
    highest: float
    correlation: float  # m over which it changes
    campaign_std: float = 0.0  # of the logarithm of a factor drawn per campaign


@dataclass(frozen=True, slots=True)
class FrictionStretch:
    """Rails of another friction between two distances from a campaign on: leaves that fell, a leaking lubricator."""

    begin: float  # m along the section
    end: float
    friction: float  # coefficient, whatever that of other places and campaigns is
    from_campaign: int = 1  # counted from 1


@dataclass(frozen=True, slots=True)
class RunningPlan:
    """What is physically more than one wheelset on linear creep and level track; the defaults add nothing."""

    creep: Creep = field(default_factory=Creep)
    friction: FrictionPlan | None = None  # None: that of ``creep`` everywhere
    cross_level: Waves | None = None
    load_variation: Waves | None = None  # std over the mean load
    out_of_round: float = 0.0  # m, amplitude of every wheel; phases are drawn
    traction: bool = False  # whether axles pull and brake as the speed changes
    driven_axles: tuple[int, ...] = ()  # from 1; empty: all
    contact_half_width: float = 0.0  # m of lateral displacement over which the contact is averaged
    contact_step: float = CONTACT_STEP  # m between points of a contact table: a contact jump is a ramp as wide
    stretches: tuple[FrictionStretch, ...] = ()  # of another friction; where they overlap the last one holds
    flats: tuple[WheelFlat, ...] = ()
    track_blows: TrackBlows | None = None

    @property
    def changes_the_track(self) -> bool:
        """Whether the track has more than alignment, gauge and curves."""
        return not (self.friction is None and self.cross_level is None and self.load_variation is None)

    @property
    def plain(self) -> bool:
        """Whether Eq. 1-5 of one wheelset hold as they are."""
        linear = self.creep.law is CreepLaw.LINEAR
        return linear and not (self.changes_the_track or self.out_of_round or self.traction)

    def shares_of_traction(self, axles: int) -> tuple[float, ...]:
        """Return the traction of each of ``axles`` axles over that of an even distribution."""
        driven = self.driven_axles or range(1, axles + 1)
        working = [axle in driven for axle in range(1, axles + 1)]
        return tuple(axles / sum(working) if works else 0.0 for works in working)
