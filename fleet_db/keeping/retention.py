"""How long what is kept: by kind, in days of our time."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from estimation.errors import ParameterError
from estimation.values.units import DAY_NS

LEAST_DAYS_OF_SAMPLES = 1.0  # what is estimated now, and the other axle of the bogie, must have them

LEAST_DAYS_OF_RECORDINGS = 31.0  # recordings that are late by 30 days still meet the raw frames of those beside them


class Kept(StrEnum):
    """Kinds of what a purge deletes; what is needed for the present state is never among it."""

    JOB_RUNS = "job_runs"  # that succeeded; the newest of each job and outcome stays
    FAILED_JOB_RUNS = "failed_job_runs"  # the newest of each job and outcome stays
    IDEMPOTENCY_KEYS = "idempotency_keys"
    SUPERSEDED_ESTIMATES = "superseded_estimates"  # geometries and trends that newer ones have replaced
    EVERY_ESTIMATE = "every_estimate"  # geometries and trends that newer ones replaced on the same day
    TRACK_REPORTS = "track_reports"  # that newer ones of the same section and version have replaced
    WINDOW_SAMPLES = "window_samples"  # of windows that are estimated, or refused for good; their bin tables stay
    WINDOW_BIN_TABLES = "window_bin_tables"  # of roll-ups whose windows are all older; their sums stay
    RECORDINGS = "recordings"  # raw bytes of decoded ones; the receipt stays, the windows stay as they are
    AUDIT = "audit"  # entries of the audit log
    WEBHOOK_DELIVERIES = "webhook_deliveries"  # what was sent, and does not wait to be sent again
    ORPHANED_FILES = "orphaned_files"  # of replaced windows, and what a killed process left


@dataclass(frozen=True, slots=True)
class Retention:
    """Days that each kind is kept; None for ever."""

    job_runs: float | None = 14.0  # after their end, as those that failed
    failed_job_runs: float | None = 180.0
    idempotency_keys: float | None = 7.0
    superseded_estimates: float | None = 730.0  # after the one that replaced it: so far back ``as_of`` answers
    every_estimate: float | None = 31.0  # after it was recorded; then the last of each day, UTC, is kept
    track_reports: float | None = 730.0
    recordings: float | None = None  # after they were received; those beside them may still come for a month
    audit: float | None = 730.0
    webhook_deliveries: float | None = 30.0
    orphaned_files: float | None = 1.0
    window_samples: float | None = 31.0  # after the start of the window
    window_bin_tables: float | None = 92.0  # after the start of the newest window of their roll-up

    def __post_init__(self) -> None:
        for kind in Kept:
            days = getattr(self, kind.value)
            if days is not None and not 0.0 < days < float("inf"):
                raise ParameterError("must be a number of days above 0", field=kind.value)
        if self.recordings is not None and self.recordings < LEAST_DAYS_OF_RECORDINGS:
            raise ParameterError(f"must be at least {LEAST_DAYS_OF_RECORDINGS:g} days", field="recordings")
        if self.window_samples is not None and self.window_samples < LEAST_DAYS_OF_SAMPLES:
            raise ParameterError(f"must be at least {LEAST_DAYS_OF_SAMPLES:g} days", field="window_samples")

    def before_ns(self, kind: Kept, now_ns: int) -> int | None:
        """Return the time before which this kind is deleted; None where it is kept for ever."""
        days: float | None = getattr(self, kind.value)
        return None if days is None else now_ns - round(days * DAY_NS)
