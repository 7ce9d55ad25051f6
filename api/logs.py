"""Logs of the services: one line an event with its facts, as JSON or as text; our own and the libraries' alike.

An error is written without local variables, bounded, and once: what follows of the same fault is counted
(:mod:`api.faults`). No line holds a password (:mod:`api.redaction`).
"""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from logging.handlers import QueueHandler, QueueListener
from queue import Full, Queue
from typing import Any

import structlog
from structlog.typing import EventDict, Processor

from api.faults import Fault, FaultLedger, fault_of, short_trace
from api.redaction import Redactor
from api.settings import Settings
from api.tracing import with_trace

CHATTY = ("apscheduler", "alembic.runtime", "uvicorn.access", "httpx", "httpcore")
"""What they log at info is in our own records, and may name URLs of receivers, which carry their secrets."""
EXPORTER = "opentelemetry.exporter.otlp.proto.http.trace_exporter"
REPETITIVE = ("asyncio", "uvicorn.error", EXPORTER)
"""They warn of what any client can cause, and of a collector that is away: their warnings are faults too."""
VALUE_CHARACTERS = 2000
"""Longest text of one fact of an event."""
QUEUED = 10_000
"""Events that wait to be written by a service that must not wait for its log; beyond, they are counted."""


def configure(settings: Settings) -> None:
    """Send every log of this process to standard error, in the form that the settings ask for."""
    shared: list[Processor] = [
        structlog.contextvars.merge_contextvars,
        structlog.stdlib.add_logger_name,
        structlog.stdlib.add_log_level,
        structlog.processors.TimeStamper(fmt="iso", utc=True),
        with_trace,
        structlog.stdlib.ExtraAdder(),
    ]
    handler = FaultHandler(sys.stderr)
    handler.setFormatter(_formatter(settings, shared))
    logging.basicConfig(handlers=[handler], level=settings.log_level.upper(), force=True)
    logging.captureWarnings(capture=True)
    logging.getLogger("apscheduler.scheduler").setLevel(logging.ERROR)  # the scheduler of the jobs reports its warnings
    for name in CHATTY:
        logging.getLogger(name).setLevel(logging.WARNING)
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            *shared[:-1],
            structlog.stdlib.PositionalArgumentsFormatter(),
            structlog.stdlib.ProcessorFormatter.wrap_for_formatter,
        ],
        logger_factory=structlog.stdlib.LoggerFactory(),
        wrapper_class=structlog.stdlib.BoundLogger,
        cache_logger_on_first_use=False,
    )


def _formatter(settings: Settings, shared: list[Processor]) -> logging.Formatter:
    redact = Redactor.of_urls([settings.url])

    def with_short_trace(_logger: object, _name: str, event: EventDict) -> EventDict:
        error = _error(event.pop("exc_info", None))
        return event if error is None else {**event, "exception": short_trace(error, redact)}

    def facts_redacted(_logger: object, _name: str, event: EventDict) -> EventDict:
        return {key: redact(value) if isinstance(value, str) else value for key, value in event.items()}

    def line_redacted(_logger: object, _name: str, line: Any) -> str:  # noqa: ANN401 - a renderer may return anything
        return redact(str(line))

    renderer: Processor = (
        structlog.processors.JSONRenderer()
        if settings.log_format == "json"
        else structlog.dev.ConsoleRenderer(
            colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
        )
    )
    return structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=shared,
        processors=[
            structlog.stdlib.ProcessorFormatter.remove_processors_meta,
            with_short_trace,
            facts_redacted,  # while nothing is escaped
            _bounded,
            renderer,
            line_redacted,  # what was no text before
        ],
    )


def _bounded(_logger: object, _name: str, event: EventDict) -> EventDict:
    for key, value in event.items():
        if key != "exception" and isinstance(value, str) and len(value) > VALUE_CHARACTERS:
            event[key] = f"{value[:VALUE_CHARACTERS]} ... ({len(value)} characters)"
    return event


def _error(given: object) -> BaseException | None:
    """Return the error of any form of ``exc_info``."""
    found = sys.exc_info()[1] if given is True else given[1] if isinstance(given, tuple) else given
    return found if isinstance(found, BaseException) else None


def _fault(record: logging.LogRecord) -> Fault | None:
    error = _error(record.msg.get("exc_info") if isinstance(record.msg, dict) else record.exc_info)
    if error is not None:
        return fault_of(error)
    if record.levelno >= logging.WARNING and record.name in REPETITIVE:
        return (record.name, "", str(record.msg))
    return None


class FaultHandler(logging.StreamHandler[Any]):
    """Writes every event, but of the same fault only the first, and then how often it came back."""

    def __init__(self, stream: Any) -> None:  # noqa: ANN401 - any text stream
        super().__init__(stream)
        self.ledger = FaultLedger()

    def emit(self, record: logging.LogRecord) -> None:
        """Write one event, after the summaries that are due."""
        now_s = time.monotonic()
        self._sum_up(self.ledger.due(now_s))
        fault = _fault(record)
        if fault is None or self.ledger.admits(fault, now_s):
            super().emit(record)

    def close(self) -> None:
        """Sum up what was counted since the last summary."""
        with self.lock or _nothing():
            self._sum_up(self.ledger.rest(time.monotonic()))
        super().close()

    def _sum_up(self, due: Iterator[tuple[Fault, int, float]]) -> None:
        for (kind, cause, place), repeats, since_s in due:
            behind = f" from {cause}" if cause else ""
            message = f"again {repeats} times in {since_s:.0f} s: {kind}{behind} at {place}"
            super().emit(logging.LogRecord("treadwatch.faults", logging.ERROR, "", 0, message, (), None))


@contextmanager
def _nothing() -> Iterator[None]:
    yield


class _Queueing(QueueHandler):
    """Hands events over as they are: what is rendered is rendered by the thread that writes."""

    dropped = 0

    def prepare(self, record: logging.LogRecord) -> logging.LogRecord:
        return record

    def enqueue(self, record: logging.LogRecord) -> None:
        try:
            self.queue.put_nowait(record)
        except Full:
            self.dropped += 1


@contextmanager
def in_background() -> Iterator[None]:
    """Write logs in a thread of its own meanwhile: no caller waits for the rendering or for standard error."""
    root = logging.getLogger()
    written, queueing = root.handlers[:], _Queueing(Queue(QUEUED))
    listener = QueueListener(queueing.queue, *written, respect_handler_level=True)
    root.handlers[:] = [queueing]
    listener.start()
    try:
        yield
    finally:
        root.handlers[:] = written
        listener.stop()
        if queueing.dropped:
            logging.getLogger("treadwatch.faults").error("%d events were not logged", queueing.dropped)
