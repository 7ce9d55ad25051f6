"""The track section that all campaigns run on: rails, survey, and the recipe or the file of its track."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Self

from annotated_types import Interval
from pydantic import AfterValidator

from estimation.contact.parameters import PROFILES
from estimation.contact.profiles import Profile, rail_profile, wheel_profile
from estimation.errors import ProfileError
from estimation.values.fields import DEG, MM, FileUnit, Key, M
from ingest.file_value import As, FileBeside, Inline, between, keys_of
from ingest.input_file import NotNegative, Positive, Text, field_error
from ingest.simulator.irregularity import FEWEST_INTERVALS, CrossLevel, IsolatedKind, LoadVariation, Waves
from ingest.simulator.running import TrackBlows
from ingest.simulator.track import TrackRecipe

DAYS_PER_YEAR = 365.25
MGT_OF_GROWTH = 100.0  # million gross tonnes, by which growth of rail wear is given
LEAST_RUN = 5.0  # of an inclination 1 in so many

SideFiles = tuple[Path | None, Path | None]  # files of the left and of the right profile; None: the built-in one


def known(look_up: Callable[[str], Profile]) -> AfterValidator:
    """Return the check that a profile of a name is built in."""

    def check(name: str) -> str:
        try:
            look_up(name)
        except ProfileError as error:
            raise field_error(error.reason) from error
        return name

    return AfterValidator(check)


def _as_built(run: float) -> float:
    if 0.0 < run < LEAST_RUN:
        raise field_error(f"{run:g} is no inclination; 20 for 1:20, or 0 where the shape contains it")
    return 0.0 if run == 0.0 else 1.0 / run


RailName = Annotated[Text, known(rail_profile)]
WheelName = Annotated[Text, known(wheel_profile)]
Inclination = Annotated[float, Interval(ge=LEAST_RUN), AfterValidator(lambda run: 1.0 / run)]
"""A tangent; in files 1 in so many."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RailFiles:
    """Rails from files."""

    rail_file: FileBeside | None = None
    rail_left_file: FileBeside | None = None
    rail_right_file: FileBeside | None = None
    built_inclination: Annotated[NotNegative, AfterValidator(_as_built), Key("rail_file_inclination_1_in")] | None = (
        None  # tangent, that rails from files are given; None: that of the section
    )
    rail_file_mirror: bool | None = None
    rail_left_file_mirror: bool | None = None
    rail_right_file_mirror: bool | None = None

    def check_rails(self) -> None:
        """Refuse keys of files that contradict each other, or that no file is given for."""
        sides = (self.rail_left_file, self.rail_right_file)
        if self.rail_file is not None and sides != (None, None):
            raise field_error("cannot be given beside the files of one side", "rail_file")
        if self.rail_file is None and sides == (None, None) and self.built_inclination is not None:
            raise field_error("needs 'rail_file'", "rail_file_inclination_1_in")
        if self.built_inclination == 0.0 and self.rail_file is None and None in sides:
            reason = "0 is for two rails from files: the built-in one has no inclination in its shape"
            raise field_error(reason, "rail_file_inclination_1_in")
        for key in ("rail_file", "rail_left_file", "rail_right_file"):
            if getattr(self, f"{key}_mirror") is not None and getattr(self, key) is None:
                raise field_error(f"needs '{key}'", f"{key}_mirror")

    @property
    def rail_files(self) -> SideFiles:
        """Files of left and right rail."""
        return self.rail_file or self.rail_left_file, self.rail_file or self.rail_right_file

    @property
    def rail_mirrors(self) -> tuple[bool | None, bool | None]:
        """Whether the gauge side is at positive y of the file, of left and right rail; None: the shape shows it."""
        if self.rail_file is not None:
            return self.rail_file_mirror, self.rail_file_mirror
        return self.rail_left_file_mirror, self.rail_right_file_mirror


Depth = Annotated[float, between(0.0, PROFILES.deepest_band / 1e-3), MM]


@dataclass(frozen=True, slots=True)
class WornRails:
    """``[section.rail_wear]``: a band on each rail; not on file."""

    depth: Depth
    depth_left: Depth | None = None
    depth_right: Depth | None = None
    centre: Annotated[float, between(-40.0, 40.0), MM] = 0.0
    half_width: Annotated[Positive, MM] = 1e-3 * 25.0
    growth: Annotated[NotNegative, FileUnit("", 1e-3), Key("growth_mm_per_100_mgt")] = 0.0
    """m of depth by 100 million gross tonnes, from the first campaign on."""

    @property
    def depths(self) -> tuple[float, float]:
        """Depth of the band on the left and on the right rail, m."""
        left, right = (self.depth if side is None else side for side in (self.depth_left, self.depth_right))
        return left, right

    def after(self, tonnage: float, days: float) -> Self:
        """Return the wear after so many days with so many million gross tonnes a year."""
        gained = self.growth * tonnage / MGT_OF_GROWTH * days / DAYS_PER_YEAR
        left, right = self.depths
        return replace(self, depth_left=left + gained, depth_right=right + gained)


@dataclass(frozen=True, slots=True)
class SurveyPlan:
    """How the survey that is on file is wrong, beside its own errors, and what it states of these."""

    shift: Annotated[float, between(-1000.0, 1000.0), M] = 0.0  # by which it is further on than the track
    alignment_factor: Annotated[float, between(-10.0, 10.0)] = 1.0
    gauge_factor: Annotated[float, between(-10.0, 10.0)] = 1.0
    gauge: bool = True  # False: no gauge was surveyed, the file has zeros
    other_section: bool = False  # it is of another section: that in ``file``, else one drawn by the same recipe
    gauge_other_section: bool = False  # its gauge alone is of that other section
    file: FileBeside | None = None
    stated_alignment_std: Annotated[NotNegative, MM] | None = None  # m; None: that of its errors
    stated_gauge_std: Annotated[NotNegative, MM] | None = None

    def of_file(self, _given: Collection[str]) -> Self:
        """Refuse a file of no other section, and a gauge that was not surveyed there."""
        if self.file is not None and not (self.other_section or self.gauge_other_section):
            raise field_error("is of another section; needs other_section or gauge_other_section = true", "file")
        if self.gauge_other_section and not self.gauge:
            raise field_error("needs a surveyed gauge; gauge is false", "gauge_other_section")
        return self


@dataclass(frozen=True, slots=True, kw_only=True)
class SectionPlan(RailFiles):
    """A section: its track by recipe, or from a recorded file."""

    code: Text
    number: Annotated[int, between(1, 65534)]
    name: Text
    rail_profile: RailName = "56E1"
    inclination: Annotated[Inclination, Key("rail_inclination_1_in")] = 1.0 / 20.0
    nominal_gauge: Annotated[float, between(500.0, 2000.0), MM] = 1e-3 * 1435.0
    survey_alignment_std: Annotated[NotNegative, MM] = 0.0  # m: error of the alignment that is on file
    survey_gauge_std: Annotated[NotNegative, MM] = 0.0
    surveyed: bool = True  # whether a survey is on file at all
    gauge_surveyed: bool = False  # whether the gauge is on file even without a survey
    latitude: Annotated[float, between(-90.0, 90.0), DEG] = 51.5  # of the section's start
    longitude: Annotated[float, between(-180.0, 180.0), DEG] = -0.2
    survey: SurveyPlan = field(default_factory=SurveyPlan)
    recipe: Annotated[TrackRecipe | None, Inline(TrackRecipe)] = None
    file: FileBeside | None = None
    rail_wear: WornRails | None = None
    tonnage: Annotated[Positive, Key("tonnage_mgt_per_year")] | None = None  # million gross tonnes a year, on file
    cross_level: Annotated[Waves, As(CrossLevel)] | None = None
    load_variation: Annotated[Waves, As(LoadVariation)] | None = None  # std over the mean load
    blows: TrackBlows | None = None

    @property
    def file_inclination(self) -> float:
        """The inclination given to rails of which one or both are from files, as a tangent."""
        return self.inclination if self.built_inclination is None else self.built_inclination

    def of_file(self, given: Collection[str]) -> Self:
        """Refuse what contradicts itself."""
        self.check_rails()
        if self.file is None:
            _check_recipe(self.recipe)
        for key in keys_of(TrackRecipe) if self.file is not None else ():
            if key in given:
                raise field_error("cannot be given beside 'file'", key)
        if self.recipe is not None:
            _check_isolated(self.recipe)
        other = self.survey.other_section or self.survey.gauge_other_section
        if other and self.survey.file is None and self.file is not None:
            raise field_error("is missing; another section cannot be drawn beside a recorded track", "survey", "file")
        if self.recipe is not None:
            _check_curves(self.recipe)
        return self


def _check_recipe(recipe: TrackRecipe | None) -> None:
    if recipe is None:
        raise field_error("is missing", "length_m")
    shortest, longest = recipe.wavelengths
    if shortest < 4.0 * recipe.interval:
        raise field_error(f"{shortest:g} m is shorter than four intervals", "shortest_wavelength_m")
    if not shortest < longest <= recipe.length:
        raise field_error(
            f"{longest:g} m must be greater than {shortest:g} m, and at most the section's {recipe.length:g} m",
            "longest_wavelength_m",
        )
    for key, waves in (("long_alignment", recipe.long_alignment), ("long_gauge", recipe.long_gauge)):
        if waves is not None and waves.wavelengths[1] > recipe.length:
            reason = f"{waves.wavelengths[1]:g} m; the section has {recipe.length:g} m"
            raise field_error(reason, key, "longest_wavelength_m")


def _check_isolated(recipe: TrackRecipe) -> None:
    """Refuse what the grid of the section cannot carry, and places that are not on it."""
    for kind, array in _ISOLATED_KEYS.items():
        for index, one in enumerate(one for one in recipe.isolated if one.kind is kind):
            if one.length < FEWEST_INTERVALS * recipe.interval:
                reason = f"is shorter than {FEWEST_INTERVALS} intervals of {recipe.interval:g} m"
                raise field_error(f"{one.length:g} m {reason}", array, index, "length_m")
            if one.at and one.at[-1] > recipe.length:
                raise field_error(f"{one.at[-1]:g} m; the section has {recipe.length:g} m", array, index, "at_m")


def _check_curves(recipe: TrackRecipe) -> None:
    for index, curve in enumerate(recipe.curves):
        for key, value in (("start_m", curve.start), ("length_m", curve.length)):
            if value > recipe.length:
                raise field_error(f"{value:g} m; the section has {recipe.length:g} m", "curves", index, key)


_ISOLATED_KEYS = {IsolatedKind.DEFECT: "defects", IsolatedKind.SWITCH: "switches", IsolatedKind.JOINT: "joints"}
