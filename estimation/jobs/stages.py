"""The pipeline: all stages, in the order in which one hands its results to the next."""

from __future__ import annotations

from estimation.jobs.refresh_geometry import GEOMETRY
from estimation.jobs.refresh_rails import OF_ALL as RAILS
from estimation.jobs.refresh_rails import OF_WHEELSETS as CELLS
from estimation.jobs.refresh_trends import TREND
from estimation.jobs.stage import AnyStage

ALL_STAGES: tuple[AnyStage, ...] = (GEOMETRY, TREND, CELLS, RAILS)
