"""Read how long what is kept from a TOML file; what is not written there keeps its shipped default.

::

    [days]
    job_runs = 14
    superseded_estimates = "for ever"
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from estimation.errors import ParameterError
from fleet_db.keeping.retention import Kept, Retention
from ingest.input_file import InputTable, read_toml

FOR_EVER = "for ever"
Days = Annotated[float, Field(gt=0.0, le=36_500.0)] | Literal["for ever"] | None


class DaysTable(InputTable):
    """Days by kind."""

    job_runs: Days = None
    failed_job_runs: Days = None
    idempotency_keys: Days = None
    superseded_estimates: Days = None
    every_estimate: Days = None
    track_reports: Days = None
    recordings: Days = None
    audit: Days = None
    webhook_deliveries: Days = None
    orphaned_files: Days = None
    window_samples: Days = None
    window_bin_tables: Days = None


class RetentionTable(InputTable):
    """The whole file."""

    days: DaysTable


def load_retention(path: Path) -> Retention:
    """Return the retention of a TOML file.

    Raises:
        InputError: The file cannot be read or is no TOML; an unknown key; a value that is no number of days. Names the
            file, the line and the field.
    """
    file = read_toml(path)
    given = file.parse(RetentionTable).days
    chosen = {kind.value: getattr(given, kind.value) for kind in Kept}
    changed = {name: None if days == FOR_EVER else days for name, days in chosen.items() if days is not None}
    try:
        return Retention(**changed)
    except ParameterError as error:
        raise file.error(error.reason, ("days", str(error.field))) from error
