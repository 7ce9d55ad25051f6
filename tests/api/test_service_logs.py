"""What is written of an error: bounded, without variables and passwords, and once."""

from __future__ import annotations

import io
import json
import logging
import re
import threading
import warnings
from collections.abc import Callable, Iterator

import pytest
import structlog

from api import logs
from api.logs import FAULTS, FULL_AGAIN_S, SUMMARY_S, TRACE_CHARACTERS, FaultLedger, Redactor, fault_of, short_trace
from api.settings import Settings
from estimation.errors import StorageError

SECRET = "p@ss/w'ö\"rd"  # noqa: S105 - of no server
URL = "postgresql://me:p%40ss%2Fw%27%C3%B6%22rd@host/db"


Configured = Callable[[str], io.StringIO]


@pytest.fixture
def configured(monkeypatch: pytest.MonkeyPatch) -> Iterator[Configured]:
    """Yield what sets the logs up and returns what is written; they are as before at the end."""
    root = logging.getLogger()
    handlers, level, structured = root.handlers[:], root.level, structlog.get_config()

    def configure(form: str) -> io.StringIO:
        stream = io.StringIO()
        monkeypatch.setattr("sys.stderr", stream)
        logs.configure(Settings.model_validate({"log_format": form, "database_url": URL}))
        return stream

    yield configure
    root.handlers[:] = handlers
    root.setLevel(level)
    logging.captureWarnings(capture=False)
    structlog.configure(**structured)


def fail(message: str, depth: int = 0) -> None:
    local_variable = SECRET  # noqa: F841 - must not be written
    if depth:
        fail(message, depth - 1)
    try:
        raise ValueError(message)  # noqa: TRY301 - the cause of the next
    except ValueError as error:
        raise StorageError("the database failed") from error


def failure(message: str, depth: int = 0) -> StorageError:
    with pytest.raises(StorageError) as caught:
        fail(message, depth)
    return caught.value


@pytest.mark.parametrize("form", ["json", "text"])
def test_an_error_is_written_without_variables_and_then_counted(configured: Configured, form: str) -> None:
    written = configured(form)
    for _ in range(30):
        logging.getLogger("one").error("request failed: %s", "/v1", exc_info=failure("inner"))
        structlog.stdlib.get_logger("other").error("request failed", path="/v1", exc_info=failure("inner"))
    logging.getLogger().handlers[0].close()
    text = written.getvalue()
    assert text.count("request failed") == 1
    assert "ValueError: inner" in text
    assert "raise ValueError(message)" in text  # the line of the code
    assert "local_variable = " not in text
    assert re.search(r"again 59 times in \d s: StorageError from ValueError at .*test_service_logs\.py:\d+", text)


@pytest.mark.parametrize("form", ["json", "text"])
def test_no_line_holds_the_password(configured: Configured, form: str) -> None:
    written = configured(form)
    log = logging.getLogger("one")
    log.error("cannot connect to %s", URL)
    log.error("with %r and %s", SECRET, json.dumps({"given": SECRET}))
    log.error("failed", exc_info=ValueError(f"no host in {URL}: {SECRET}"))
    for before in range(450, 500):  # wherever a long message is cut
        structlog.stdlib.get_logger("other").error(
            "cut", exc_info=type(f"E{before}", (Exception,), {})("x" * before + SECRET)
        )
    structlog.stdlib.get_logger("other").error("failed", address=URL, given=SECRET)
    warnings.simplefilter("always")
    warnings.warn(f"another user's: postgresql://root:other@host/db password={SECRET} password='other'", stacklevel=1)
    text = written.getvalue()
    assert text.count("***") >= 7
    for secret in (SECRET, "p%40ss", "p@ss", "other@", "'other'"):
        assert secret not in text
        assert json.dumps(secret)[1:-1] not in text


def test_a_url_without_a_password_stays_as_it_is() -> None:
    plain = "see http://host:8000/v1/alerts and mail a@b, password unknown, postgresql://me@host/db"
    assert Redactor.of_urls([None, "sqlite:////x", "postgresql://me@host/db"])(plain) == plain
    assert Redactor.of_urls(["postgresql://me:dog@host/db"])("the dog barks") == "the dog barks"


def test_a_trace_is_bounded(configured: Configured) -> None:
    written = configured("json")
    error = failure("x" * 100_000, depth=300)
    trace = short_trace(error)
    assert len(trace) <= TRACE_CHARACTERS
    assert trace.startswith("estimation.errors.StorageError: the database failed\n")
    assert trace.count("test_service_logs.py") < 20
    first = ValueError("first")
    second = ValueError("second")
    first.__cause__, second.__cause__ = second, first
    assert short_trace(first).count("ValueError") == 2
    assert "KeyError: 'inside'" in short_trace(ExceptionGroup("many", [KeyError("inside")]))
    logging.getLogger("one").error("long %s", "y" * 100_000, exc_info=error)
    assert len(written.getvalue()) < TRACE_CHARACTERS + 4000


def test_a_fault_is_full_at_first_then_summed_up_once_a_minute_and_full_again_after_an_hour() -> None:
    ledger, fault = FaultLedger(), fault_of(failure("one"))
    assert fault == fault_of(failure("two"))
    assert fault != fault_of(StorageError("elsewhere"))
    assert ledger.admits(fault, 0.0)
    assert not any(ledger.admits(fault, 0.1 * step) for step in range(1, 8))
    assert list(ledger.due(SUMMARY_S - 1.0)) == []
    assert list(ledger.due(SUMMARY_S)) == [(fault, 7, SUMMARY_S)]
    assert list(ledger.due(3.0 * SUMMARY_S)) == []
    assert not ledger.admits(fault, FULL_AGAIN_S - 1.0)
    assert ledger.admits(fault, FULL_AGAIN_S)


def test_the_number_of_faults_remembered_is_bounded() -> None:
    ledger = FaultLedger()
    for number in range(FAULTS + 1):
        assert ledger.admits((str(number),), 0.0)
    assert not ledger.admits((str(FAULTS),), 0.0)
    assert ledger.admits(("0",), 0.0)  # forgotten


def test_what_any_client_can_cause_is_counted_too(configured: Configured) -> None:
    written = configured("text")
    for _ in range(50):
        logging.getLogger("uvicorn.error").warning("Invalid HTTP request received.")
        logging.getLogger("ingest").warning("rejected %s", "file")
    assert written.getvalue().count("Invalid HTTP request") == 1
    assert written.getvalue().count("rejected file") == 50


def test_a_service_does_not_wait_for_its_log_and_loses_no_line(configured: Configured) -> None:
    written = configured("json")
    names = []

    def note_thread(_record: logging.LogRecord) -> bool:
        names.append(threading.current_thread().name)
        return True

    logging.getLogger().handlers[0].addFilter(note_thread)
    with logs.in_background():
        structlog.contextvars.bind_contextvars(request_id="r-1")
        for number in range(100):
            structlog.stdlib.get_logger("other").info("event", number=number)
        structlog.contextvars.clear_contextvars()
    assert threading.current_thread().name not in names
    lines = [json.loads(line) for line in written.getvalue().splitlines()]
    assert [line["number"] for line in lines] == list(range(100))
    assert {line["request_id"] for line in lines} == {"r-1"}
    logging.getLogger("one").info("and now again in this thread")
    assert "in this thread" in written.getvalue()
