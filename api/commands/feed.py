"""``treadwatch feed``: what happens to alerts, line by line; the reference client of the feed."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def feed(
    *,
    follow: Annotated[
        bool, typer.Option("--follow/--once", help="Go on until Ctrl-C is pressed, or end with what there is.")
    ] = False,
    after: Annotated[str | None, typer.Option(help="Begin behind this cursor; 'latest': behind the newest.")] = None,
    fleet: Annotated[list[str] | None, typer.Option(help="Only of this fleet; may be repeated.")] = None,
    kind: Annotated[list[str] | None, typer.Option(help="Only of this kind; may be repeated.")] = None,
    severity: Annotated[
        list[str] | None, typer.Option(help="Only alerts that have had this severity; may be repeated.")
    ] = None,
    state: Annotated[
        Path | None, typer.Option(help="File that keeps the cursor; the next call goes on behind it.")
    ] = None,
    url: Annotated[
        str, typer.Option(envvar="TREADWATCH_URL", help="Address of the service.")
    ] = "http://127.0.0.1:8000",
    as_json: Annotated[bool, typer.Option("--json", help="Print events as JSON, one a line.")] = False,
) -> None:
    """Print what happens to alerts, in commit order; the key of the service is read from TREADWATCH_KEY."""
    import os

    import httpx

    from api.feed_client import Follower
    from api.terminal.feed import Lines, read_state
    from estimation.errors import ParameterError

    if not url.startswith(("http://", "https://")):
        raise ParameterError("must begin with http:// or https://", field="--url")
    kept = read_state(state)
    key = os.environ.get("TREADWATCH_KEY")
    if key is not None and not (key.isascii() and key.isprintable()):
        raise ParameterError("holds characters that no key has", field="TREADWATCH_KEY")
    named = (("fleet", fleet), ("kind", kind), ("severity", severity))
    query = [(name, value) for name, values in named for value in values or ()]
    headers = {} if key is None else {"Authorization": f"Bearer {key}"}
    with httpx.Client(base_url=url, headers=headers, timeout=30.0, trust_env=False) as http:
        follower = Follower(http, query, Lines(as_json, state), after if kept is None else kept)
        try:
            follower.follow() if follow else follower.once()
        except KeyboardInterrupt:
            return
        except BrokenPipeError:  # whoever read the lines has gone
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
