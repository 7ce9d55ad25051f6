"""Which vehicle class is on file of the vehicles."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from estimation.errors import ScenarioError
from ingest.input_file import InputTable, Text, field_error
from ingest.simulator.class_on_file import ClassOnFile
from ingest.simulator.scenario_schema.units import MM
from ingest.vehicle_class_file import read_vehicle_class, shipped_classes, shipped_path


class ClassOnFileTable(InputTable):
    """``[class_on_file]``."""

    file: Text | None = None
    shipped: Text | None = None
    nominal_radius_mm: Annotated[float, Field(ge=150.0, le=700.0)] | None = None

    @model_validator(mode="after")
    def _check_file(self) -> Self:
        if (self.file is None) == (self.shipped is None):
            raise field_error("needs either 'file' or 'shipped'")
        if self.shipped is not None and self.shipped not in shipped_classes():
            raise field_error(f"{self.shipped!r} is none of {', '.join(shipped_classes())}", "shipped")
        return self

    def plan(self, folder: Path) -> ClassOnFile:
        """Return what is on file.

        Args:
            folder: Folder of the scenario file: a relative file name starts here.

        Raises:
            ScenarioError: The file is no class file.
        """
        path = shipped_path(self.shipped) if self.shipped is not None else folder / str(self.file)
        radius = None if self.nominal_radius_mm is None else MM * self.nominal_radius_mm
        return ClassOnFile(path, read_vehicle_class(path, ScenarioError), radius)
