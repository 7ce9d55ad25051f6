"""The REST application for a server that makes processes of its own: ``uvicorn --factory api.asgi:app --workers 2``.

Each process has its own database connections, caches and measures. ``treadwatch serve`` is one process with more limits
on connections.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fastapi import FastAPI


def app() -> FastAPI:
    """Return the application of the deployment that the environment describes.

    Linear algebra runs on one thread, as in every command: sums over several have other last bits, and a job that is
    asked for here is to give what the scheduler and its workers give.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # read when numpy is loaded
    from api import logs  # noqa: PLC0415 - not before that
    from api.cli import choose_compiled_code  # noqa: PLC0415 - the same
    from api.http_server import keep_what_is_loaded  # noqa: PLC0415 - the same
    from api.logs import start_tracing  # noqa: PLC0415 - the same
    from api.serving import create_app  # noqa: PLC0415 - the same
    from api.settings import load_settings  # noqa: PLC0415 - the same

    choose_compiled_code(os.environ)
    settings = load_settings()
    logs.configure(settings)
    start_tracing()
    app = create_app(settings)
    keep_what_is_loaded()
    return app
