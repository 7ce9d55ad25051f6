"""The survey of a section as it is on file, where that is not the track with small errors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from ingest.input_file import InputTable, NotNegative, Text, field_error
from ingest.simulator.scenario import SurveyPlan
from ingest.simulator.scenario_schema.units import MM

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
