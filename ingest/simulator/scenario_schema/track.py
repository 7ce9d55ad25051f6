"""The section that the vehicles run on: profiles, survey, curves, the recipe of its irregularities."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from ingest.input_file import IncreasingNumbers, InputTable, NotNegative, Positive, Text, field_error
from ingest.simulator.curves import Curve
from ingest.simulator.irregularity import Waves
from ingest.simulator.isolated import FEWEST_INTERVALS, Isolated, IsolatedKind
from ingest.simulator.kurtosis import GAUSSIAN, HIGHEST
from ingest.simulator.scenario import SectionPlan, SurveyPlan
from ingest.simulator.scenario_schema.profile_names import RailName
from ingest.simulator.scenario_schema.rails import RailFiles, RailWearTable
from ingest.simulator.scenario_schema.running_plan import CrossLevelTable, LoadVariationTable, TrackBlowsTable
from ingest.simulator.scenario_schema.units import KM, MM
from ingest.simulator.track import TrackRecipe

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


Factor = Annotated[float, Field(ge=-10.0, le=10.0)]


class SurveyTable(InputTable):
    """``[section.survey]``."""

    shift_m: float = Field(default=0.0, ge=-1000.0, le=1000.0)
    alignment_factor: Factor = 1.0
    gauge_factor: Factor = 1.0
    gauge: bool = True
    other_section: bool = False
    gauge_other_section: bool = False
    file: Text | None = None
    stated_alignment_std_mm: NotNegative | None = None
    stated_gauge_std_mm: NotNegative | None = None

    @model_validator(mode="after")
    def _check_other_section(self) -> Self:
        if self.file is not None and not (self.other_section or self.gauge_other_section):
            raise field_error("is of another section; needs other_section or gauge_other_section = true", "file")
        if self.gauge_other_section and not self.gauge:
            raise field_error("needs a surveyed gauge; gauge is false", "gauge_other_section")
        return self

    def plan(self, folder: Path) -> SurveyPlan:
        """Return the survey in SI units.

        Args:
            folder: Folder of the scenario file: a relative ``file`` starts here.
        """
        alignment_std, gauge_std = self.stated_alignment_std_mm, self.stated_gauge_std_mm
        return SurveyPlan(
            other_section=self.other_section,
            gauge_other_section=self.gauge_other_section,
            file=None if self.file is None else folder / self.file,
            shift=self.shift_m,
            alignment_factor=self.alignment_factor,
            gauge_factor=self.gauge_factor,
            gauge=self.gauge,
            stated_alignment_std=None if alignment_std is None else MM * alignment_std,
            stated_gauge_std=None if gauge_std is None else MM * gauge_std,
        )


MIN_CURVE_RADIUS = 150.0  # m
Kurtosis = Annotated[float, Field(ge=GAUSSIAN, le=HIGHEST)]


def _curve_radius(radius: float) -> float:
    if abs(radius) < MIN_CURVE_RADIUS:
        raise field_error(f"{radius:g} m is no radius; at least {MIN_CURVE_RADIUS:g} m, negative to the right")
    return radius


class CurveTable(InputTable):
    """``[[section.curves]]``."""

    start_m: NotNegative
    length_m: Positive
    radius_m: Annotated[float, Field(ge=-1e6, le=1e6), AfterValidator(_curve_radius)]
    cant_mm: float = Field(default=0.0, ge=-200.0, le=200.0)
    transition_m: Positive = 80.0

    @model_validator(mode="after")
    def _check_transitions(self) -> Self:
        if self.length_m <= 2.0 * self.transition_m:
            raise field_error(f"{self.length_m:g} m is no longer than both transitions", "length_m")
        return self

    def plan(self) -> Curve:
        """Return the curve in SI units."""
        return Curve(
            start=self.start_m,
            length=self.length_m,
            radius=self.radius_m,
            cant=MM * self.cant_mm,
            transition=self.transition_m,
        )


class SectionTable(RailFiles):
    """``[section]``."""

    code: Text
    number: int = Field(ge=1, le=65534)
    name: Text
    rail_profile: RailName = "56E1"
    rail_inclination_1_in: float = Field(default=20.0, ge=5.0)
    nominal_gauge_mm: float = Field(default=1435.0, ge=500.0, le=2000.0)
    survey_alignment_std_mm: NotNegative = 0.0
    survey_gauge_std_mm: NotNegative = 0.0
    surveyed: bool = True
    gauge_surveyed: bool = False
    survey: SurveyTable = Field(default_factory=SurveyTable)
    latitude_deg: float = Field(default=51.5, ge=-90.0, le=90.0)
    longitude_deg: float = Field(default=-0.2, ge=-180.0, le=180.0)
    file: Text | None = None
    length_m: Positive | None = None
    interval_m: Positive = 0.25
    shortest_wavelength_m: Positive = 3.0
    longest_wavelength_m: Positive = 70.0
    alignment_std_mm: float = Field(default=2.0, ge=0.0, le=50.0)
    gauge_std_mm: float = Field(default=0.0, ge=0.0, le=20.0)
    gauge_offset_mm: float = Field(default=0.0, ge=-20.0, le=40.0)
    alignment_kurtosis: Kurtosis = GAUSSIAN
    gauge_kurtosis: Kurtosis = GAUSSIAN
    long_alignment: LongWavesTable | None = None
    long_gauge: LongWavesTable | None = None
    cross_level: CrossLevelTable | None = None
    load_variation: LoadVariationTable | None = None
    blows: TrackBlowsTable | None = None
    curves: list[CurveTable] = Field(default_factory=list)
    defects: list[DefectTable] = Field(default_factory=list)
    switches: list[SwitchTable] = Field(default_factory=list)
    joints: list[JointTable] = Field(default_factory=list)
    rail_wear: RailWearTable | None = None
    tonnage_mgt_per_year: Positive | None = None

    @model_validator(mode="after")
    def _check_recipe(self) -> Self:
        if self.file is not None:
            for key in _RECIPE_KEYS:
                if key in self.model_fields_set:
                    raise field_error("cannot be given beside 'file'", key)
            return self
        if self.length_m is None:
            raise field_error("is missing", "length_m")
        if self.shortest_wavelength_m < 4.0 * self.interval_m:
            raise field_error(
                f"{self.shortest_wavelength_m:g} m is shorter than four intervals", "shortest_wavelength_m"
            )
        if not self.shortest_wavelength_m < self.longest_wavelength_m <= self.length_m:
            raise field_error(
                f"{self.longest_wavelength_m:g} m must be greater than {self.shortest_wavelength_m:g} m, "
                f"and at most the section's {self.length_m:g} m",
                "longest_wavelength_m",
            )
        for key, waves in (("long_alignment", self.long_alignment), ("long_gauge", self.long_gauge)):
            if waves is not None and waves.longest_wavelength_m > self.length_m:
                reason = f"{waves.longest_wavelength_m:g} m; the section has {self.length_m:g} m"
                raise field_error(reason, key, "longest_wavelength_m")
        return self

    @model_validator(mode="after")
    def _check_isolated(self) -> Self:
        length = math.inf if self.length_m is None else self.length_m
        for kind, tables in self._isolated().items():
            for index, table in enumerate(tables):
                for key, reason in table.impossible(self.interval_m, length):
                    raise field_error(reason, _ISOLATED_KEYS[kind], index, key)
        return self

    def _isolated(self) -> Mapping[IsolatedKind, Sequence[IsolatedTable]]:
        return {
            IsolatedKind.DEFECT: self.defects,
            IsolatedKind.SWITCH: self.switches,
            IsolatedKind.JOINT: self.joints,
        }

    @model_validator(mode="after")
    def _check_survey(self) -> Self:
        other = self.survey.other_section or self.survey.gauge_other_section
        if other and self.survey.file is None and self.file is not None:
            raise field_error("is missing; another section cannot be drawn beside a recorded track", "survey", "file")
        return self

    @model_validator(mode="after")
    def _check_curves(self) -> Self:
        length = math.inf if self.length_m is None else self.length_m
        for index, curve in enumerate(self.curves):
            for key, value in (("start_m", curve.start_m), ("length_m", curve.length_m)):
                if value > length:
                    raise field_error(f"{value:g} m; the section has {length:g} m", "curves", index, key)
        return self

    def plan(self, folder: Path) -> SectionPlan:
        """Return the section in SI units.

        Args:
            folder: Folder of the scenario file: a relative ``file`` starts here.
        """
        return SectionPlan(
            code=self.code,
            number=self.number,
            name=self.name,
            rail_profile=self.rail_profile,
            inclination=1.0 / self.rail_inclination_1_in,
            nominal_gauge=MM * self.nominal_gauge_mm,
            recipe=self._recipe(),
            file=None if self.file is None else folder / self.file,
            survey_alignment_std=MM * self.survey_alignment_std_mm,
            survey_gauge_std=MM * self.survey_gauge_std_mm,
            surveyed=self.surveyed,
            gauge_surveyed=self.gauge_surveyed,
            survey=self.survey.plan(folder),
            rail_files=self.files(folder),
            rail_mirrors=self.mirrors,
            file_inclination=self.inclination_of_files(self.rail_inclination_1_in),
            latitude=self.latitude_deg,
            longitude=self.longitude_deg,
            rail_wear=(None, None) if self.rail_wear is None else self.rail_wear.plan(),
            rail_growth=0.0 if self.rail_wear is None else MM * self.rail_wear.growth_mm_per_100_mgt,
            tonnage=self.tonnage_mgt_per_year,
        )

    def _recipe(self) -> TrackRecipe | None:
        if self.length_m is None:
            return None
        return TrackRecipe(
            length=self.length_m,
            interval=self.interval_m,
            alignment_std=MM * self.alignment_std_mm,
            gauge_std=MM * self.gauge_std_mm,
            gauge_offset=MM * self.gauge_offset_mm,
            wavelengths=(self.shortest_wavelength_m, self.longest_wavelength_m),
            curves=tuple(curve.plan() for curve in self.curves),
            long_alignment=None if self.long_alignment is None else self.long_alignment.plan(),
            long_gauge=None if self.long_gauge is None else self.long_gauge.plan(),
            alignment_kurtosis=self.alignment_kurtosis,
            gauge_kurtosis=self.gauge_kurtosis,
            isolated=tuple(table.plan(kind) for kind, tables in self._isolated().items() for table in tables),
        )


_RECIPE_KEYS = (
    "length_m",
    "interval_m",
    "shortest_wavelength_m",
    "longest_wavelength_m",
    "alignment_std_mm",
    "gauge_std_mm",
    "gauge_offset_mm",
    "curves",
    "alignment_kurtosis",
    "gauge_kurtosis",
    "long_alignment",
    "long_gauge",
    "defects",
    "switches",
    "joints",
)
_ISOLATED_KEYS = {IsolatedKind.DEFECT: "defects", IsolatedKind.SWITCH: "switches", IsolatedKind.JOINT: "joints"}
