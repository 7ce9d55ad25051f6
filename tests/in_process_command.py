"""The command line in the process of the tests, which has imported everything already."""

from __future__ import annotations

import logging
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest
import structlog

from api.cli import main


@dataclass(frozen=True)
class Done:
    """What a command left behind."""

    returncode: int
    stdout: str
    stderr: str


Run = Callable[..., Done]


@contextmanager
def command_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Run]:
    """Yield what runs a command; its traces are removed afterwards."""
    signals = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    handlers, level, structured = logging.root.handlers[:], logging.root.level, structlog.get_config()

    def run(*arguments: object, **environment: str) -> Done:
        monkeypatch.setattr(sys, "argv", ["treadwatch", *map(str, arguments)])
        for name, value in environment.items():
            monkeypatch.setenv(f"TREADWATCH_{name.upper()}", value)
        code = 0
        try:
            main()
        except SystemExit as end:
            code = int(end.code or 0)
        captured = capsys.readouterr()
        return Done(code, captured.out, captured.err)

    yield run
    for number, handler in signals.items():
        signal.signal(number, handler)
    logging.root.handlers[:] = handlers
    logging.root.setLevel(level)
    structlog.configure(**structured)
