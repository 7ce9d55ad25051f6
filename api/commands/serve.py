"""``treadwatch serve``: the REST API, until it is asked to stop."""

from __future__ import annotations

from typing import Annotated

import typer


def serve(
    *,
    host: Annotated[
        str | None, typer.Option(help="Address to listen on.  [env var: TREADWATCH_HOST; default: 127.0.0.1]")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(help="Port to listen on; 0 takes a free one.  [env var: TREADWATCH_PORT; default: 8000]"),
    ] = None,
) -> None:
    """Serve the REST API; its documentation is on /docs."""
    import threading

    from api import factory, logs
    from api.settings import load_settings
    from api.tracing import start_tracing
    from estimation.jobs.stop_signals import stop_on_signals

    settings = load_settings(host=host, port=port)
    logs.configure(settings)
    start_tracing()
    stopping = threading.Event()
    stop_on_signals(stopping)  # the server hands its signal on when it has stopped
    with logs.in_background():
        factory.serve(settings, stopping)
