"""A recording in the log format of the page is read."""

from __future__ import annotations

import sys
from pathlib import Path

import can

import ingest
from ingest.logs.formats import read_log

if __name__ == "__main__":
    file = Path(sys.argv[1]) / "recording.csv"
    with can.CSVWriter(file) as writer:
        for number in range(5):
            writer(can.Message(timestamp=1.7e9 + number, arbitration_id=0x123, data=[number], is_extended_id=False))
    batch = read_log(file)
    assert len(batch.arbitration_id) == 5, batch
    print(ingest.__file__)  # noqa: T201 - for the test: which copy ran
