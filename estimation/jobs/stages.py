"""The pipeline: all stages, in the order in which one hands its results to the next.

A job runs its stages (``estimation.jobs.catalogue``); a worker finds the stage of a unit here, by its name.
"""

from __future__ import annotations

from estimation.jobs.compare_identities import IDENTITIES, JUMPS, SUSPENSIONS
from estimation.jobs.estimate_windows import TABLES
from estimation.jobs.evaluate_alerts import ALERTS, WORKLIST
from estimation.jobs.refresh_adhesion import FIRST, OF_SECTIONS, OF_VEHICLES
from estimation.jobs.refresh_adhesion import OF_WINDOWS as CREEP
from estimation.jobs.refresh_alignment import ALIGNMENT
from estimation.jobs.refresh_geometry import GEOMETRY
from estimation.jobs.refresh_rails import OF_ALL as RAILS
from estimation.jobs.refresh_rails import OF_WHEELSETS as CELLS
from estimation.jobs.refresh_signatures import OF_ALL as ANSWERS
from estimation.jobs.refresh_trends import TREND
from estimation.jobs.stage import AnyStage
from estimation.jobs.steps.outdated_windows import OUTDATED
from estimation.jobs.steps.plausibility import JUDGE
from estimation.jobs.steps.signature_windows import ASSUMED, OF_WINDOWS

ALL_STAGES: tuple[AnyStage, ...] = (
    ALIGNMENT,
    JUDGE,
    OUTDATED,
    TABLES,
    GEOMETRY,
    FIRST,
    CREEP,
    OF_VEHICLES,
    OF_SECTIONS,
    TREND,
    JUMPS,
    IDENTITIES,
    SUSPENSIONS,
    ALERTS,
    WORKLIST,
    CELLS,
    RAILS,
    ASSUMED,
    OF_WINDOWS,
    ANSWERS,
)
