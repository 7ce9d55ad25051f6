"""Numbers of `estimation` that stand outside a value of parameters, for ``python -m bench house``.

A loose numeric constant is a name to which a module, a class or a default argument of `estimation` gives a number, or
something with numbers in it: a tuple, an array, a mapping, arithmetic of literals. Each name counts once.

Not loose are the fields of a frozen dataclass that is a value of parameters (its name ends as one of ``PARAMETERS``):
they are handed down, and they are in the provenance. Not counted are

- 0 and 1 as defaults of fields and arguments (nothing of it; as it is), and members of an enumeration;
- types with the range of a field (``Annotated``, ``Interval``), units of files (``FileUnit``), and places in a table;
- stages and jobs, which say how often they are due;
- values of parameters that are made here (``STEP = StepModel(...)``), and empty values (``Check(0.0, ...)``);
- ``DEFINED``: the profiles of wheels and rails that standards define, as they define them.

Counted apart are the names of ``APART``, because they decide nothing about a number: how many of what there are, grids
on which something is tabulated, versions of what is stored, what is kept in memory or shown at most, who works when on
what, the range of what may be entered, and dimensions of EN 13715 as it gives them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

PARAMETERS = re.compile(
    r"\w*(Parameters|Settings|Rule|Delays|Model|Limits|Gates|Uncertainty|Prior|Running|Std|Class|Layout)"
)
UNCOUNTED = re.compile(r"\b(Annotated|Interval|FileUnit|Stage|Job|Served|SpeedBand)\(|\bAnnotated\[|\bdatetime\(")
NEUTRAL = frozenset({0, 1, -1})
DEFINED = frozenset({"estimation/contact/wheel_definitions.py"})
SIZES = {  # how many of what there are, and grids on which something is tabulated
    "accuracy/wheel_contact": "AMPLITUDES",
    "adhesion/pass_sums": "SCALES POINTS GRID",
    "adhesion/stationary_filter": "AXLE",
    "adhesion/window_adhesion": "DISPLACEMENT DEPTHS STEPS",
    "contact/conicity": "_ANGLES _PLACES",
    "contact/kernels": "FOUND NO_OVERLAP FLANGE_TIP OUTER_EDGE NO_ROLL",
    "contact/penalised_spline": "DEGREE ORDER BAND LEVELS",
    "estimators/hidden_displacement": "FINE MIDDLES GRID",
    "estimators/interface": "CELLS",
    "estimators/paper_algorithm": "REGRESSORS MIDDLES",
    "estimators/series": "UNKNOWNS",
    "filters": "ORDER LENGTHS",
    "motion/rolling_sums": "ROWS TERMS",
    "rails/published": "PARAMETERS",
    "signatures/calibration": "SHARES FACTORS",
    "signatures/mixed_model": "TERMS LEVEL",
    "tables/bin_table": "LATERAL_REGRESSORS LATERAL_COLUMNS NOISE OUTSIDE GOLDEN HALF",
    "track/gauge/wheel_functions": "KNOTS DIFFERENCES GAUGES REACH",
    "trend/change_point": "NOISE_SHARES",
    "trend/extrapolation": "AMPLITUDES",
    "values/opinions": "CELL_LENGTH FRICTIONS INVERSE SHARES",
    "values/registry": "MAX_AXLES",
    "values/signatures": "SIGNALS POWERS CROSSES",
    "vehicle/linear_model": "SIGNALS",
    "vehicle/observability": "_FREQUENCIES",
    "vehicle/kalker": "_ROWS",
    "vehicle/regressors": "YAW_TARGET_COLUMNS REGRESSORS SHARED_IN_BOGIE",
    "vehicle/vehicle_class": "AXLES_OF_A_BOGIE",
}
VERSIONS = {  # of what is stored
    "jobs/steps/assumptions": "ROLL_UP_VERSION",
    "jobs/steps/rail_cells": "CELL_VERSION",
    "jobs/steps/signature_windows": "VERSION",
    "tables/bin_table": "TABLE_VERSION",
    "vehicle/vehicle_class": "SHIPPED_VERSION",
    "worklist/stored": "FORM",
}
KEPT = {  # in memory, or worked on at once
    "adhesion/stationary_filter": "KEPT",
    "adhesion/window_adhesion": "KEPT",
    "dampers/damper_filters": "KEPT",
    "filters": "PIECES LANES",
    "geometry/sharpening": "_KEPT",
    "jobs/refresh_adhesion": "BATCH KEPT_NS",
    "jobs/refresh_geometry": "SUMS_IN_MEMORY",
    "jobs/stage": "at_once",
    "jobs/steps/epoch_inputs": "_READ",
    "jobs/steps/epoch_passes": "IN_MEMORY",
    "jobs/steps/load_window": "KEPT",
    "jobs/steps/rolling": "KEPT_WAITING READ_AHEAD READ_TOGETHER",
    "jobs/steps/signature_windows": "AT_ONCE",
    "jobs/steps/wheelset_facts": "MORE",
    "motion/window_motion": "FEWEST_POINTS POINTS SPLINE_MARGIN PIECES TRACKS",
    "rails/two_way": "ROWS_AT_ONCE",
    "tables/bin_table": "KEYS",
    "trend/extrapolation": "KEPT",
    "trend/trend": "KEPT_TRENDS",
}
SHOWN = {  # at most, and digits of it
    "alerts/life_cycle": "MOST_REFERENCES REFERENCE_LENGTH",
    "alerts/rule_book": "DIGEST_LETTERS MOST_NAMED",
    "alerts/rules/conicity_limit": "SPEED_DIGITS",
    "signatures/answer": "SHOWN",
    "trend/extrapolation": "SHOWN",
    "trend/wear_curve": "LOOKED_AT",
    "values/alerts": "number_evidence(digits) forecast_evidence(digits)",
    "values/roll_up": "MOST_CHOSEN",
    "values/runs": "MOST_ENDED ERROR_LENGTH",
    "worklist/row": "REFUSALS_NAMED",
    "worklist/stored": "FAR_KM BAND_KM",
}
OPERATION = {  # who works when on what
    "compiled": "OTHERS_MAY_WRITE",
    "jobs/estimate_windows": "APART_NS",
    "jobs/job": "LEASE_S",
    "jobs/runner": "CLAIMED_TOGETHER",
    "jobs/scheduler": "CHECK_S STEP_NS LONGEST_LEASE_S",
    "jobs/work": "AHEAD MOST_TRIES LOOK_S UNITS_EACH",
    "values/runs": "FIRST_DELAY_S PASSING_FACTOR PASSING_LONGEST_S FAILED_FACTOR FAILED_LONGEST_S",
}
RANGES = {  # of what may be entered
    "contact/smoothed_profile": "MOST_POINTS",
    "values/geometry": "MOST_INTERVALS",
    "values/registry": "MOST_KM FARTHEST_M",
    "values/track": "MOST_TONNAGE_MGT",
}
DEFINITIONS = {"contact/profiles": "HEIGHTS THICKNESSES SLOPES _FACE _FACE_END _ROOT _TIP_RADIUS _RIM _USUAL_SLOPE"}
APART = {
    (f"estimation/{module}.py", name)
    for kind in (SIZES, VERSIONS, KEPT, SHOWN, OPERATION, RANGES, DEFINITIONS)
    for module, names in kind.items()
    for name in names.split()
}


@dataclass(frozen=True)
class Loose:
    """One name, where it stands, and what it is given."""

    path: str
    line: int
    name: str
    value: str

    @property
    def apart(self) -> bool:
        """Whether no number of a result depends on it."""
        return (self.path, self.name) in APART

    def __str__(self) -> str:
        return f"{self.path}:{self.line} {self.name} = {self.value[:80]}"


def loose_constants(root: Path) -> Iterator[Loose]:
    """Yield every loose numeric constant of `estimation`."""
    for path in sorted((root / "estimation").rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if name not in DEFINED:
            yield from _of_body(name, ast.parse(path.read_text(encoding="utf-8")).body, inside=False)


def _of_body(path: str, body: list[ast.stmt], *, inside: bool) -> Iterator[Loose]:
    for node in body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            yield from _assigned(path, node, inside=inside)
        elif isinstance(node, ast.ClassDef) and not _is_parameters(node):
            yield from _of_body(path, node.body, inside=True)
        elif isinstance(node, ast.FunctionDef):
            yield from _defaults(path, node)


def _is_parameters(node: ast.ClassDef) -> bool:
    frozen = any("frozen=True" in ast.unparse(item) for item in node.decorator_list)
    return any("Enum" in ast.unparse(base) for base in node.bases) or (frozen and bool(PARAMETERS.fullmatch(node.name)))


def _assigned(path: str, node: ast.Assign | ast.AnnAssign, *, inside: bool) -> Iterator[Loose]:
    assert node.value is not None
    text = ast.unparse(node.value)
    if isinstance(node.value, ast.Call):
        made = ast.unparse(node.value.func)
        if PARAMETERS.fullmatch(made) or (made[:1].isupper() and _numbers(node.value) <= NEUTRAL):
            return
    if UNCOUNTED.search(text) or not _numbers(node.value) or (inside and _numbers(node.value) <= NEUTRAL):
        return
    target = node.targets[0] if isinstance(node, ast.Assign) else node.target
    for name in target.elts if isinstance(target, ast.Tuple) else [target]:
        yield Loose(path, node.lineno, ast.unparse(name), text)


def _defaults(path: str, node: ast.FunctionDef) -> Iterator[Loose]:
    places = [*node.args.posonlyargs, *node.args.args]
    given = [*zip(places[len(places) - len(node.args.defaults) :], node.args.defaults, strict=True)]
    for argument, value in [*given, *zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True)]:
        if value is not None and _numbers(value) - NEUTRAL:
            yield Loose(path, node.lineno, f"{node.name}({argument.arg})", ast.unparse(value))


def _numbers(node: ast.expr) -> set[float]:
    """Return the numbers in an expression, but for those that only choose an item."""
    chosen = {id(item) for part in ast.walk(node) if isinstance(part, ast.Subscript) for item in ast.walk(part.slice)}
    constants = [part for part in ast.walk(node) if isinstance(part, ast.Constant) and id(part) not in chosen]
    return {one.value for one in constants if isinstance(one.value, int | float) and not isinstance(one.value, bool)}
