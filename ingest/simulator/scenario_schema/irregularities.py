"""Irregularities of a section beside those of its band of wavelengths: long waves, isolated ones."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Self

from pydantic import Field, model_validator

from ingest.input_file import IncreasingNumbers, InputTable, Positive, field_error
from ingest.simulator.irregularity import Waves
from ingest.simulator.isolated import FEWEST_INTERVALS, Isolated, IsolatedKind
from ingest.simulator.scenario_schema.units import KM, MM

Size = Annotated[float, Field(ge=-30.0, le=30.0)]  # mm


class LongWavesTable(InputTable):
    """``[section.long_alignment]``, ``[section.long_gauge]``."""

    std_mm: float = Field(ge=0.0, le=50.0)
    shortest_wavelength_m: Positive = 100.0
    longest_wavelength_m: Positive = 1000.0

    @model_validator(mode="after")
    def _check_band(self) -> Self:
        if self.longest_wavelength_m <= self.shortest_wavelength_m:
            reason = f"{self.longest_wavelength_m:g} m must be greater than {self.shortest_wavelength_m:g} m"
            raise field_error(reason, "longest_wavelength_m")
        return self

    def plan(self) -> Waves:
        """Return the waves in SI units; they have the form of the spectrum of alignment, also those of gauge."""
        return Waves("alignment", MM * self.std_mm, (self.shortest_wavelength_m, self.longest_wavelength_m))


class IsolatedTable(InputTable):
    """``[[section.defects]]``, ``[[section.switches]]``, ``[[section.joints]]``."""

    at_m: IncreasingNumbers = Field(default_factory=list)
    per_km: float = Field(default=0.0, ge=0.0, le=200.0)
    length_m: float = Field(gt=0.0, le=200.0)
    alignment_mm: Size = 0.0
    gauge_mm: Size = 0.0

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        if not self.at_m and self.per_km == 0.0:
            raise field_error("is missing; give the middles, or 'per_km' to draw them", "at_m")
        if self.alignment_mm == 0.0 and self.gauge_mm == 0.0:
            raise field_error("is missing, and 'gauge_mm' too: it changes nothing", "alignment_mm")
        return self

    def impossible(self, interval: float, length: float) -> Iterator[tuple[str, str]]:
        """Yield keys and reasons: what the grid of the section cannot carry, places that are not on the section.

        Args:
            interval, length: Of the grid and of the section, m.
        """
        if self.length_m < FEWEST_INTERVALS * interval:
            yield "length_m", f"{self.length_m:g} m is shorter than {FEWEST_INTERVALS} intervals of {interval:g} m"
        if self.at_m and self.at_m[-1] > length:
            yield "at_m", f"{self.at_m[-1]:g} m; the section has {length:g} m"

    def plan(self, kind: IsolatedKind) -> Isolated:
        """Return the irregularities in SI units."""
        return Isolated(
            kind=kind,
            length=self.length_m,
            alignment=MM * self.alignment_mm,
            gauge=MM * self.gauge_mm,
            at=tuple(self.at_m),
            per_metre=self.per_km / KM,
        )


class DefectTable(IsolatedTable):
    """``[[section.defects]]``."""

    length_m: float = Field(default=10.0, gt=0.0, le=200.0)


class SwitchTable(IsolatedTable):
    """``[[section.switches]]``."""

    length_m: float = Field(default=20.0, gt=0.0, le=200.0)
    alignment_mm: Size = 2.0
    gauge_mm: Size = -3.0


class JointTable(IsolatedTable):
    """``[[section.joints]]``."""

    length_m: float = Field(default=4.0, gt=0.0, le=200.0)
    alignment_mm: Size = 0.8
    gauge_mm: Size = -0.5
