"""The REST application for a server that makes processes of its own: ``uvicorn --factory api.asgi:app --workers 2``.

Each process has its own database connections, caches and measures. ``treadwatch serve`` is one process with more limits
on connections.
"""

from __future__ import annotations

import os

from fastapi import FastAPI

from api import factory, logs
from api.compiled_code import choose_compiled_code
from api.kept_objects import keep_what_is_loaded
from api.settings import load_settings
from api.tracing import start_tracing


def app() -> FastAPI:
    """Return the application of the deployment that the environment describes.

    Raises
    ------
    InputError, MigrationError, ParameterError, StorageError
        As ``treadwatch serve``; the server ends with the error.
    """
    choose_compiled_code(os.environ)
    settings = load_settings()
    logs.configure(settings)
    start_tracing()
    found = factory.create_app(settings)
    keep_what_is_loaded()
    return found
