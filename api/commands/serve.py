"""``treadwatch serve``: the REST API, until it is asked to stop."""

from __future__ import annotations

from typing import Annotated

import typer
import uvicorn

from api import logs
from api.factory import create_app
from api.settings import Settings, load_settings


def server(settings: Settings) -> uvicorn.Server:
    """Return the server of the API; it ends on SIGTERM or SIGINT after running requests have been answered."""
    config = uvicorn.Config(
        create_app(settings),
        host=settings.host,
        port=settings.port,
        log_config=None,
        access_log=False,
        server_header=False,
        timeout_graceful_shutdown=settings.shutdown_timeout_s,
    )
    return uvicorn.Server(config)


def serve(
    *,
    host: Annotated[str | None, typer.Option(help="Address to listen on.")] = None,
    port: Annotated[int | None, typer.Option(help="Port to listen on; 0 takes a free one.")] = None,
) -> None:
    """Serve the REST API; its documentation is on /docs."""
    settings = load_settings(host=host, port=port)
    logs.configure(settings)
    server(settings).run()
