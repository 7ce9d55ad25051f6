"""The times of ``treadwatch reassemble``: with and without a zone, and none that cannot be stored."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from api.terminal.ingest import reassemble_and_report
from estimation.errors import ParameterError


@pytest.mark.parametrize(
    ("begin", "end", "field"),
    [
        (None, datetime(9999, 12, 31), "--to"),  # noqa: DTZ001 - as the command line gives a bare date
        (datetime(1, 1, 1, tzinfo=UTC), None, "--from"),
        (datetime(2024, 1, 9), datetime(2024, 1, 8, tzinfo=UTC), "--to"),  # noqa: DTZ001 - one with, one without
    ],
)
def test_a_time_that_cannot_be_is_refused_with_its_field(
    begin: datetime | None, end: datetime | None, field: str
) -> None:
    with pytest.raises(ParameterError, match=field):
        reassemble_and_report("N-1", begin, end)
