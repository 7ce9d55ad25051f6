"""Creep and friction, wheels and traction, and what the track adds to its line."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from ingest.input_file import InputTable, NotNegative, Positive, Text, field_error
from ingest.simulator.blows import TrackBlows, WheelFlat
from ingest.simulator.creep_laws import Creep, CreepLaw
from ingest.simulator.irregularity import Waves
from ingest.simulator.running import CONTACT_STEP, FrictionPlan, FrictionStretch
from ingest.simulator.scenario_schema.units import MM
from ingest.simulator.surface import STRETCH_END

SHORTEST_STRETCH = 2.0 * STRETCH_END  # m: its friction is reached somewhere
Share = Annotated[float, Field(gt=0.0, le=1.0)]
_LAWS = {law.name.lower(): law for law in CreepLaw}


def _law(text: str) -> str:
    if text not in _LAWS:
        raise field_error(f"{text!r} is none of {', '.join(_LAWS)}")
    return text


class StretchTable(InputTable):
    """``[[creep.stretches]]``."""

    from_m: NotNegative
    to_m: Positive
    friction: Share
    from_campaign: int = Field(default=1, ge=1)

    @model_validator(mode="after")
    def _check_length(self) -> Self:
        if self.to_m < self.from_m + SHORTEST_STRETCH:
            reason = f"{self.to_m:g} m must be {SHORTEST_STRETCH:g} m or more behind 'from_m', {self.from_m:g} m"
            raise field_error(reason, "to_m")
        return self

    def plan(self) -> FrictionStretch:
        """Return the stretch."""
        return FrictionStretch(self.from_m, self.to_m, self.friction, self.from_campaign)


class CreepTable(InputTable):
    """``[creep]``."""

    law: Annotated[Text, AfterValidator(_law)] = "linear"
    friction: Share = 0.4
    lowest_friction: Share | None = None
    highest_friction: Share | None = None
    correlation_m: Positive = 100.0
    campaign_std_percent: float = Field(default=0.0, ge=0.0, le=100.0)
    adhesion_factor: Share = 1.0
    slip_factor: Share = 1.0
    sliding_friction_share: Share = 1.0
    sliding_decay_s_m: NotNegative = 0.0
    stretches: list[StretchTable] = Field(default_factory=list)

    @model_validator(mode="after")
    def _check_friction(self) -> Self:
        if self.law == "linear" and (needless := self.model_fields_set - {"law"}):
            raise field_error("has no effect with law = 'linear'", min(needless))
        low, high = self.lowest_friction, self.highest_friction
        if (low is None) != (high is None):
            raise field_error("is missing", "lowest_friction" if low is None else "highest_friction")
        if low is not None and high is not None:
            if "friction" in self.model_fields_set:
                raise field_error("cannot be given beside its limits", "friction")
            if high < low:
                raise field_error(f"{high:g} is below 'lowest_friction', {low:g}", "highest_friction")
        return self

    @model_validator(mode="after")
    def _check_polach(self) -> Self:
        only = {"adhesion_factor", "slip_factor", "sliding_friction_share", "sliding_decay_s_m"}
        if self.law != "polach" and (needless := self.model_fields_set & only):
            raise field_error("has no effect without law = 'polach'", min(needless))
        if self.slip_factor > self.adhesion_factor:
            raise field_error("is above 'adhesion_factor'", "slip_factor")
        return self

    def plan(self) -> Creep:
        """Return the law; its friction is the mean where that varies."""
        low, high = self.lowest_friction, self.highest_friction
        return Creep(
            law=_LAWS[self.law],
            friction=self.friction if low is None or high is None else 0.5 * (low + high),
            adhesion=self.adhesion_factor,
            slip=self.slip_factor,
            residual=self.sliding_friction_share,
            decay=self.sliding_decay_s_m,
        )

    def friction_plan(self) -> FrictionPlan | None:
        """Return how friction varies; None where it does not."""
        if self.lowest_friction is None and self.campaign_std_percent == 0.0:
            return None
        low, high = self.lowest_friction or self.friction, self.highest_friction or self.friction
        return FrictionPlan(low, high, self.correlation_m, self.campaign_std_percent / 100.0)


class _BandTable(InputTable):
    shortest_wavelength_m: Positive = 3.0
    longest_wavelength_m: Positive = 70.0

    @model_validator(mode="after")
    def _check_band(self) -> Self:
        if self.longest_wavelength_m <= self.shortest_wavelength_m:
            reason = f"{self.longest_wavelength_m:g} m must be greater than {self.shortest_wavelength_m:g} m"
            raise field_error(reason, "longest_wavelength_m")
        return self


class CrossLevelTable(_BandTable):
    """``[section.cross_level]``."""

    std_mm: float = Field(ge=0.0, le=20.0)

    def plan(self) -> Waves:
        """Return the waves, m; they have the form of the spectrum of cross level, which is that of gauge."""
        return Waves("gauge", MM * self.std_mm, (self.shortest_wavelength_m, self.longest_wavelength_m))


class LoadVariationTable(_BandTable):
    """``[section.load_variation]``."""

    std_percent: float = Field(ge=0.0, le=40.0)

    def plan(self) -> Waves:
        """Return the waves, over the mean load."""
        return Waves("gauge", self.std_percent / 100.0, (self.shortest_wavelength_m, self.longest_wavelength_m))


def _wheel(text: str) -> str:
    if text not in ("left", "right"):
        raise field_error(f"{text!r} is neither left nor right")
    return text


class FlatTable(InputTable):
    """``[[wheels.flats]]``."""

    wheelset: Text
    wheel: Annotated[Text, AfterValidator(_wheel)] = "left"
    blow_m_s2: float = Field(gt=0.0, le=500.0)
    from_campaign: int = Field(default=1, ge=1)

    def plan(self) -> WheelFlat:
        """Return the flat."""
        return WheelFlat(self.wheelset, self.wheel == "left", self.blow_m_s2, self.from_campaign)


class TrackBlowsTable(InputTable):
    """``[section.blows]``."""

    every_m: float = Field(ge=5.0, le=1e5)
    blow_m_s2: float = Field(gt=0.0, le=500.0)

    def plan(self) -> TrackBlows:
        """Return the blows."""
        return TrackBlows(self.every_m, self.blow_m_s2)


class WheelsTable(InputTable):
    """``[wheels]``."""

    out_of_round_mm: float = Field(default=0.0, ge=0.0, le=2.0)
    contact_half_width_mm: float = Field(default=0.0, ge=0.0, le=5.0)
    contact_step_mm: float = Field(default=CONTACT_STEP / MM, ge=0.001, le=0.2)
    flats: list[FlatTable] = Field(default_factory=list)


class TractionTable(InputTable):
    """``[traction]``."""

    driven_axles: list[Annotated[int, Field(ge=1)]] = Field(default_factory=list)
