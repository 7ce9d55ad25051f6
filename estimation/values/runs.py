"""The record of a run of a job."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from estimation.values.served import Served


class JobTrigger(StrEnum):
    """Who asked for a run."""

    SCHEDULE = "schedule"
    API = "api"
    CLI = "cli"


class JobOutcome(StrEnum):
    """How a run stands or ended."""

    RUNNING = "running"
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    ABANDONED = "abandoned"  # a stop was asked for, or the process ended


@dataclass(frozen=True, slots=True)
class JobRun:
    """One run of one job; ``finished_ns`` None until its end is recorded. ``counts`` are what it did."""

    run_id: Annotated[int, Served("", "id", example=42)]
    job: Annotated[str, Served(example="estimate_windows")]
    trigger: JobTrigger
    started_ns: int
    finished_ns: int | None
    outcome: JobOutcome
    counts: Mapping[str, int]
    error: str | None = None
