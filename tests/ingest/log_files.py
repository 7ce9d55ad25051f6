"""Log files of every format that is read: BLF by our writer, the others by python-can."""

from __future__ import annotations

import time
from pathlib import Path

import can
import pytest

from ingest.frames import FrameBatch, channel_number
from ingest.live.listening import messages_of
from ingest.logs import write_blf


def write_recording(path: Path, batch: FrameBatch) -> None:
    """Write a batch in the format that the suffix names."""
    if path.suffix == ".blf":
        write_blf(path, batch)
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TZ", "UTC")  # python-can writes local dates into ASC files
        time.tzset()
        _write_with_python_can(path, batch)
    time.tzset()


def _write_with_python_can(path: Path, batch: FrameBatch) -> None:
    writers = {".asc": can.ASCWriter, ".log": can.CanutilsLogWriter, ".mf4": can.MF4Writer}
    with writers[path.suffix](path) as writer:
        if path.suffix == ".asc":
            # the date of a log has whole milliseconds, unpadded: begin at a whole second
            first = int(batch.t_ns.min()) // 1_000_000_000 if len(batch) else 0
            writer.log_event("Start of measurement", float(first) or None)
        for message in messages_of(batch):
            message.channel = batch.channel if path.suffix == ".log" else channel_number(batch.channel) - 1
            writer.on_message_received(message)
