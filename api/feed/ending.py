"""Whether the server of this process is about to end, also one that ours did not start."""

from __future__ import annotations

import signal

import uvicorn


def ending() -> bool:
    """Return whether a signal has asked uvicorn to end.

    A server that makes processes of its own (``uvicorn --workers 2``) tells its applications only when the last
    connection is closed, for which those that stream would let it wait. It has its own handler of the signal.
    """
    server = getattr(signal.getsignal(signal.SIGTERM), "__self__", None)
    return isinstance(server, uvicorn.Server) and server.should_exit
