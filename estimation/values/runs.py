"""The record of a run of a job."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class JobRun:
    """One run of one job; ``finished_ns`` None while running. ``counts`` are what it did."""

    run_id: int
    job: str
    trigger: str  # "schedule", "api", "cli"
    started_ns: int
    finished_ns: int | None
    outcome: str  # "running", "succeeded", "failed", "abandoned"
    counts: Mapping[str, int]
    error: str | None = None
