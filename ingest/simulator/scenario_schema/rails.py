"""Rails of a section from files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, Field, model_validator

from estimation.contact.wear import DEEPEST_BAND, RailWear
from ingest.input_file import InputTable, NotNegative, Positive, Text, field_error
from ingest.simulator.rail_course import MGT_OF_GROWTH
from ingest.simulator.scenario import SideFiles, SideMirrors
from ingest.simulator.scenario_schema.units import MM


def _as_built(run: float) -> float:
    if 0.0 < run < LEAST_RUN:
        raise field_error(f"{run:g} is no inclination; 20 for 1:20, or 0 where the shape contains it")
    return run


LEAST_RUN = 5.0  # of an inclination 1 in so many


Depth = Annotated[float, Field(ge=0.0, le=DEEPEST_BAND / MM)]


class RailWearTable(InputTable):
    """``[section.rail_wear]``."""

    depth_mm: Depth
    depth_left_mm: Depth | None = None
    depth_right_mm: Depth | None = None
    centre_mm: float = Field(default=0.0, ge=-40.0, le=40.0)
    half_width_mm: Positive = 25.0
    growth_mm_per_100_mgt: NotNegative = 0.0

    def deepest_mm(self, traffic_mgt: float) -> float:
        """Return the depth of the deeper band after some traffic, mm."""
        deeper = max(side for side in (self.depth_mm, self.depth_left_mm, self.depth_right_mm) if side is not None)
        return deeper + self.growth_mm_per_100_mgt * traffic_mgt / MGT_OF_GROWTH

    def plan(self) -> tuple[RailWear, RailWear]:
        """Return the wear of left and right rail in SI units."""
        left, right = (self.depth_mm if one is None else one for one in (self.depth_left_mm, self.depth_right_mm))
        form = (MM * self.centre_mm, MM * self.half_width_mm)
        return RailWear(MM * left, *form), RailWear(MM * right, *form)


class RailFiles(InputTable):
    """Keys of rails from files, in ``[section]`` and ``[[drawn_fleet.pairs]]``."""

    rail_file: Text | None = None
    rail_left_file: Text | None = None
    rail_right_file: Text | None = None
    rail_file_inclination_1_in: Annotated[NotNegative, AfterValidator(_as_built)] | None = None
    rail_file_mirror: bool | None = None
    rail_left_file_mirror: bool | None = None
    rail_right_file_mirror: bool | None = None

    @model_validator(mode="after")
    def _check_rail_files(self) -> Self:
        sides = (self.rail_left_file, self.rail_right_file)
        if self.rail_file is not None and sides != (None, None):
            raise field_error("cannot be given beside the files of one side", "rail_file")
        if self.rail_file is None and sides == (None, None) and self.rail_file_inclination_1_in is not None:
            raise field_error("needs 'rail_file'", "rail_file_inclination_1_in")
        if self.rail_file_inclination_1_in == 0.0 and self.rail_file is None and None in sides:
            reason = "0 is for two rails from files: the built-in one has no inclination in its shape"
            raise field_error(reason, "rail_file_inclination_1_in")
        return self

    @model_validator(mode="after")
    def _check_mirrors(self) -> Self:
        for key in ("rail_file", "rail_left_file", "rail_right_file"):
            if getattr(self, f"{key}_mirror") is not None and getattr(self, key) is None:
                raise field_error(f"needs '{key}'", f"{key}_mirror")
        return self

    def rail_names(self) -> list[tuple[str, str, bool | None]]:
        """Return key, name and mirror of the files that are given."""
        named = (
            ("rail_file", self.rail_file, self.rail_file_mirror),
            ("rail_left_file", self.rail_left_file, self.rail_left_file_mirror),
            ("rail_right_file", self.rail_right_file, self.rail_right_file_mirror),
        )
        return [(key, name, mirror) for key, name, mirror in named if name is not None]

    def files(self, folder: Path) -> SideFiles:
        """Return the files of left and right rail.

        Args:
            folder: Folder of the scenario file: relative names start here.
        """
        left, right = (self.rail_file or side for side in (self.rail_left_file, self.rail_right_file))
        return None if left is None else folder / left, None if right is None else folder / right

    @property
    def mirrors(self) -> SideMirrors:
        """Whether the gauge side is at positive y of the file, of left and right rail; None: the shape shows it."""
        if self.rail_file is not None:
            return self.rail_file_mirror, self.rail_file_mirror
        return self.rail_left_file_mirror, self.rail_right_file_mirror

    def inclination_of_files(self, built_1_in: float) -> float:
        """Return the inclination that rails from files are given, as a tangent.

        Args:
            built_1_in: Inclination of the section, 1 in so many: where the table says nothing else.
        """
        run = built_1_in if self.rail_file_inclination_1_in is None else self.rail_file_inclination_1_in
        return 0.0 if run == 0.0 else 1.0 / run
