"""Rows of the adhesion bench around ``quiet``: single wheelsets whose sensors hide nothing of what is in the motion.

In most of them the rails are dry, so that every alarm is false. What each row puts beside is what creep was once taken
for low friction with: small forces, errors of survey and gauge, cross level, curves that nobody registered, a load that
is wrong, sensors, other profiles, speed. ``..._leaves`` have two stretches of low friction, which are due.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bench.adhesion_wrong import WrongFile, as_on_file
from ingest.file_value import read_value
from ingest.input_file import InputFile
from ingest.simulator.scenario import Scenario
from ingest.simulator.scenario_file import ScenarioTable

if TYPE_CHECKING:  # it loads compiled code
    from bench.adhesion_fleet import Fleet

OF = "quiet"  # the scenario that they change


@dataclass(frozen=True, slots=True)
class QuietRow:
    """What a row changes of the scenario, by table, and what is wrong on file."""

    tables: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    wrong: WrongFile = field(default_factory=WrongFile)
    gravity_on_file: bool = True  # whether the class says that its accelerometers measure gravity


LEAVES: dict[str, Any] = {
    "stretches": [
        {"from_m": 900.0, "to_m": 1200.0, "friction": 0.08},
        {"from_m": 2400.0, "to_m": 2600.0, "friction": 0.06},
    ]
}
GENTLE = [
    {"start_m": 600.0, "length_m": 700.0, "radius_m": 6000.0, "cant_mm": 20.0},
    {"start_m": 2000.0, "length_m": 800.0, "radius_m": -5000.0, "cant_mm": -25.0},
]
ALONE: dict[str, dict[str, Any]] = {"drawn_fleet": {"vehicles": 1}}
S1002 = {
    "name": "S1002/60E1",
    "wheel_profile": "S1002",
    "rail_profile": "60E1",
    "rail_inclination_1_in": 40.0,
    "deepest_wear_mm": 1.0,
}
QUIET = {
    OF: QuietRow(),
    "quiet_alone": QuietRow(ALONE),
    "quiet_wet": QuietRow({"creep": {"friction": 0.2}}),
    "quiet_wet_alone": QuietRow({"creep": {"friction": 0.2}} | ALONE),
    "quiet_smooth": QuietRow({"section": {"alignment_std_mm": 1.0}}),
    "quiet_survey": QuietRow({"section": {"survey_alignment_std_mm": 0.5}}),
    "quiet_gauge": QuietRow({"section": {"gauge_std_mm": 1.5, "gauge_surveyed": False}}),
    "quiet_level": QuietRow({"section": {"cross_level": {"std_mm": 5.0}}}),
    "quiet_twist": QuietRow({"section": {"cross_level": {"std_mm": 8.0, "shortest_wavelength_m": 30.0}}}),
    "quiet_curves": QuietRow({"section": {"curves": GENTLE}}),
    "quiet_load": QuietRow(wrong=WrongFile(load=1.12)),
    "quiet_scales": QuietRow({"sensors": {"scale_error_std_percent": 3.0}}),
    "quiet_gravity": QuietRow(gravity_on_file=False),
    "quiet_fast": QuietRow({"speed": {"lowest_m_s": 30.0, "highest_m_s": 40.0}, "section": {"length_m": 10500.0}}),
    "quiet_s1002": QuietRow({"drawn_fleet": {"pairs": [S1002]}}),
    "quiet_leaves": QuietRow({"creep": LEAVES}),
    "quiet_leaves_alone": QuietRow({"creep": LEAVES} | ALONE),
}


def quiet_scenario(folder: Path, row: QuietRow) -> Scenario:
    """Return the scenario of a row.

    Args:
        folder: With the file of the scenario that rows change.
    """
    path = folder / f"{OF}.toml"
    tables = tomllib.loads(path.read_text(encoding="utf-8"))
    changed = {name: tables.get(name, {}) | dict(table) for name, table in row.tables.items()}
    return read_value(InputFile(path, tables | changed), ScenarioTable).scenario()


def as_seen(fleet: Fleet, row: QuietRow) -> Fleet:
    """Return a fleet as one sees it whose file is that of a row; the truth of its windows stays."""
    seen = as_on_file(fleet, row.wrong)
    if row.gravity_on_file:
        return seen
    windows = tuple(replace(one, window=replace(one.window, measures_gravity=False)) for one in seen.windows)
    return replace(seen, windows=windows)
