"""OpenTelemetry traces, where the deployment names a collector in the environment of the standard (``OTEL_...``).

The spans themselves are made through the API of OpenTelemetry, which does nothing until traces are started: requests by
the web framework, runs of jobs and recordings by us. What sends them is the extra ``treadwatch[otel]``.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version

from opentelemetry import trace
from structlog.typing import EventDict

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
