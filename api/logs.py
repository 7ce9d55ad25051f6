"""Logs of the services: one line an event with its facts, as JSON or as text; our own and the libraries' alike.

An error is written without local variables, bounded, and once: what follows of the same fault is counted. No line holds
a password.
"""

from __future__ import annotations

import json
import logging
import os
import re
import sys
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.metadata import version
from logging.handlers import QueueHandler, QueueListener
from queue import Full, Queue
from typing import Any
from urllib.parse import quote, quote_plus, unquote

import structlog
from opentelemetry import trace
from structlog.typing import EventDict, Processor

from api.settings import Settings
from estimation.errors import ParameterError
from estimation.jobs.job import Job, JobContext

ENDPOINTS = ("OTEL_EXPORTER_OTLP_TRACES_ENDPOINT", "OTEL_EXPORTER_OTLP_ENDPOINT")
EXTRA = "treadwatch[otel]"
SERVICE = "treadwatch"
_log = logging.getLogger(__name__)


def start_tracing() -> bool:
    """Send traces from now on, where the environment names a collector; return whether it does."""
    variable = _asked_by(os.environ)
    if variable is None:
        return False
    try:
        from opentelemetry.exporter.otlp.proto.http.trace_exporter import OTLPSpanExporter  # noqa: PLC0415 - an extra
        from opentelemetry.sdk.resources import Resource  # noqa: PLC0415 - the same
        from opentelemetry.sdk.trace import TracerProvider  # noqa: PLC0415 - the same
        from opentelemetry.sdk.trace.export import BatchSpanProcessor  # noqa: PLC0415 - the same
    except ModuleNotFoundError:
        reason = f"is set, and what sends traces is not installed: pip install '{EXTRA}'"
        raise ParameterError(reason, field=variable) from None
    named = {"service.version": version("treadwatch")}
    if not os.environ.get("OTEL_SERVICE_NAME") and "service.name=" not in os.environ.get(
        "OTEL_RESOURCE_ATTRIBUTES", ""
    ):
        named["service.name"] = SERVICE
    provider = TracerProvider(resource=Resource.create(named))
    provider.add_span_processor(BatchSpanProcessor(OTLPSpanExporter()))
    trace.set_tracer_provider(provider)
    _log.info("traces are sent to the collector of %s", variable)
    return True


def _asked_by(environment: Mapping[str, str]) -> str | None:
    """Return the variable that names a collector; None where there is none, or traces are switched off."""
    if environment.get("OTEL_SDK_DISABLED", "").strip().lower() == "true":
        return None
    if environment.get("OTEL_TRACES_EXPORTER", "").strip().lower() == "none":
        return None
    return next((name for name in ENDPOINTS if environment.get(name)), None)


def traced(job: Job) -> Job:
    """Return a job whose runs are spans, with what they did as attributes."""

    def run(context: JobContext) -> Mapping[str, int]:
        with trace.get_tracer(SERVICE).start_as_current_span(f"job {job.name}") as span:
            counts = job.run(context)
            span.set_attributes({f"treadwatch.{name}": count for name, count in counts.items()})
            return counts

    return replace(job, run=run)


def with_trace(_logger: object, _name: str, event: EventDict) -> EventDict:
    """Add the trace that an event belongs to, so that logs and traces are found by each other."""
    context = trace.get_current_span().get_span_context()
    if not context.is_valid:
        return event
    return {**event, "trace_id": f"{context.trace_id:032x}", "span_id": f"{context.span_id:016x}"}


SUMMARY_S = 60.0  # a fault that goes on is summed up this often, in seconds
FULL_AGAIN_S = 3600.0  # after this long its trace is written again, in seconds
FAULTS = 500  # faults that are remembered; beyond, the one not seen for longest is forgotten
FRAMES, CAUSES, MESSAGE_CHARACTERS, TRACE_CHARACTERS = 12, 4, 500, 8000
"""Bounds of one trace: innermost calls of an error, errors behind it, characters of a message and of the whole."""

Fault = tuple[str, ...]


def fault_of(error: BaseException) -> Fault:
    """Return what identifies a fault: the types of the error and of its cause, and where it was raised."""
    place, trace = "", error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    if trace is not None:
        place = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}"
    cause = error.__cause__
    return (type(error).__qualname__, "" if cause is None else type(cause).__qualname__, place)


def short_trace(error: BaseException, clean: Callable[[str], str] = str) -> str:
    """Return a trace without local variables, bounded in depth and characters, the error itself first."""
    parts, raised, seen = [], error, set[int]()
    for _ in range(CAUSES):
        seen.add(id(raised))
        parts += [f"{_heading(raised, clean)}\n", *traceback.extract_tb(raised.__traceback__, limit=-FRAMES).format()]
        behind = raised.__cause__ or (None if raised.__suppress_context__ else raised.__context__)
        if behind is None or id(behind) in seen:
            break
        parts.append("from ")
        raised = behind
    return "".join(parts)[:TRACE_CHARACTERS].rstrip()


def _heading(error: BaseException, clean: Callable[[str], str]) -> str:
    heading = f"{type(error).__module__}.{type(error).__qualname__}: {error}"
    inside = "".join(f"\n  {type(inner).__qualname__}: {inner}" for inner in getattr(error, "exceptions", ())[:CAUSES])
    return clean(heading)[:MESSAGE_CHARACTERS] + clean(inside)[:MESSAGE_CHARACTERS]


@dataclass(slots=True)
class _Seen:
    full_at_s: float
    written_at_s: float
    repeats: int = 0


@dataclass(slots=True)
class FaultLedger:
    """Decides which errors are written in full; for one thread at a time."""

    _seen: OrderedDict[Fault, _Seen] = field(default_factory=OrderedDict)

    def admits(self, fault: Fault, now_s: float) -> bool:
        """Return whether this occurrence is to be written in full; otherwise it is counted."""
        earlier = self._seen.get(fault)
        if earlier is not None and now_s - earlier.full_at_s < FULL_AGAIN_S:
            earlier.repeats += 1
            self._seen.move_to_end(fault)
            return False
        self._seen[fault] = _Seen(now_s, now_s)
        if len(self._seen) > FAULTS:
            self._seen.popitem(last=False)
        return True

    def due(self, now_s: float, after_s: float = SUMMARY_S) -> Iterator[tuple[Fault, int, float]]:
        """Yield the faults to be summed up: which, how often it came back, within how many seconds."""
        for fault, counted in self._seen.items():
            since_s = now_s - counted.written_at_s
            if counted.repeats and since_s >= after_s:
                yield fault, counted.repeats, since_s
                counted.repeats, counted.written_at_s = 0, now_s


HIDDEN = "***"
_IN_URL = re.compile(r"(?P<before>[a-zA-Z][a-zA-Z0-9+.-]*://[^\s:/@]*:)[^\s@]+(?=@)")
_NAMED = re.compile(r"(?P<before>\bpassword['\"]?\s*[=:]\s*)(?:'[^']*'|\\?\"[^\"]*\"|[^\s,;&)}]+)", re.IGNORECASE)
_WEBHOOK_SECRET = re.compile(r"\bwhsec_[A-Za-z0-9+/=_-]{4,}")
_SHORTEST = 4
"""Characters of a password from which on it is looked for as such; a shorter one would blot out common words."""


def password_in(url: str) -> str | None:
    """Return the password of a URL as it is written there; None without one."""
    authority = url.partition("://")[2]
    user, separator, _ = authority.rpartition("@")
    _, colon, password = user.partition(":")
    return password if separator and colon and password else None


@dataclass(frozen=True)
class Redactor:
    """Replaces passwords in a text."""

    secrets: tuple[str, ...] = ()

    @classmethod
    def of_urls(cls, urls: Iterable[str | None]) -> Redactor:
        """Return the redactor of the passwords in these URLs."""
        return cls(tuple(found for url in urls if url for found in [password_in(url)] if found))

    @cached_property
    def _forms(self) -> tuple[str, ...]:
        forms: set[str] = set()
        for secret in self.secrets:
            for form in {secret, unquote(secret)}:
                forms |= {form, quote(form, safe=""), quote_plus(form), json.dumps(form)[1:-1], repr(form)[1:-1]}
        return tuple(sorted((form for form in forms if len(form) >= _SHORTEST), key=len, reverse=True))

    def __call__(self, text: str) -> str:
        """Return ``text`` without passwords."""
        for form in self._forms:
            text = text.replace(form, HIDDEN)
        if "://" in text:
            text = _IN_URL.sub(rf"\g<before>{HIDDEN}", text)
        if "password" in text.lower():
            text = _NAMED.sub(rf"\g<before>{HIDDEN}", text)
        if "whsec_" in text:
            text = _WEBHOOK_SECRET.sub(f"whsec_{HIDDEN}", text)
        return text


CHATTY = ("apscheduler", "alembic.runtime", "uvicorn.access", "httpx", "httpcore")
"""What they log at info is in our own records, and may name URLs of receivers, which carry their secrets."""
EXPORTER = "opentelemetry.exporter.otlp.proto.http.trace_exporter"
REPETITIVE = ("asyncio", "uvicorn.error", EXPORTER)
"""They warn of what any client can cause, and of a collector that is away: their warnings are faults too."""
VALUE_CHARACTERS = 2000  # longest text of one fact of an event
QUEUED = 10_000  # events that wait to be written by a service that must not wait for its log; beyond, they are counted


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
    error = sys.exc_info()[1] if given is True else given[1] if isinstance(given, tuple) else given
    return error if isinstance(error, BaseException) else None


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
        with self.lock or nullcontext():
            self._sum_up(self.ledger.due(time.monotonic(), 0.0))
        super().close()

    def _sum_up(self, due: Iterator[tuple[Fault, int, float]]) -> None:
        for (kind, cause, place), repeats, since_s in due:
            behind = f" from {cause}" if cause else ""
            message = f"again {repeats} times in {since_s:.0f} s: {kind}{behind} at {place}"
            super().emit(logging.LogRecord("treadwatch.faults", logging.ERROR, "", 0, message, (), None))


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
