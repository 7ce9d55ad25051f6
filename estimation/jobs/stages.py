"""The pipeline: all stages, in the order in which one hands its results to the next."""

from __future__ import annotations

from estimation.jobs.refresh_trends import TREND
from estimation.jobs.stage import AnyStage

ALL_STAGES: tuple[AnyStage, ...] = (TREND,)
