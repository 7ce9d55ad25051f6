"""The process that starts a process for each log file: small, of one thread, with everything imported.

Run as ``python -m ingest.logs.server SOCKET``, with the descriptor of one end of a socket pair. A request is one JSON
object with descriptors: where the answer goes, and the files of columns. The answer has a line from the process that
reads, unless it was ended, and a line with how it ended. This process ends when the other end of the socket is closed,
however that happens, and the ones that it started end with it.
"""

from __future__ import annotations

import importlib
import json
import os
import select
import signal
import socket
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from estimation.values.reasons import ReasonCode
from ingest.logs import child
from ingest.logs.log_format import COLUMNS, ReadLimits

REQUEST_BYTES = 16_384
DESCRIPTORS = 1 + len(COLUMNS)


def main(arguments: Sequence[str]) -> None:
    """Serve until the other end of the socket is closed."""
    requests = socket.socket(fileno=int(arguments[0]))
    woken, waker = os.pipe()
    os.set_blocking(waker, False)
    os.set_blocking(woken, False)
    signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    for name in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(name, signal.SIG_IGN)
    reading: dict[int, int] = {}  # descriptor of the answer, by process
    poll = select.poll()
    poll.register(requests, select.POLLIN)
    poll.register(woken, select.POLLIN)
    while True:
        ready = {descriptor for descriptor, _ in poll.poll()}
        if woken in ready:
            with suppress(BlockingIOError):
                os.read(woken, 512)
            _reap(reading)
        if requests.fileno() in ready and not _serve(requests, reading):
            return


def _serve(requests: socket.socket, reading: dict[int, int]) -> bool:
    message, descriptors, _, _ = socket.recv_fds(requests, REQUEST_BYTES, DESCRIPTORS)
    if not message:
        return False
    request: dict[str, Any] = json.loads(message)
    for module in request["modules"]:
        with suppress(ImportError):  # the reader says which extra is missing
            importlib.import_module(module)
    answer, *columns = descriptors
    own = os.getpid()
    try:
        process = os.fork()
    except OSError as error:
        refused = {"passing": f"no process to read it: {error.strerror}", "code": ReasonCode.WAITS_FOR_MEMORY}
        os.write(answer, json.dumps(refused).encode() + b"\n")
        process = -1
    if process == 0:
        try:
            requests.close()
            _close_what_is_not_its_own(reading)
            child.main(Path(request["path"]), ReadLimits(**request["limits"]), answer, columns, own)
        finally:
            os._exit(1)
    for column in columns:
        os.close(column)
    if process < 0:
        os.close(answer)
    else:
        reading[process] = answer
    return True


def _close_what_is_not_its_own(reading: dict[int, int]) -> None:
    for other in reading.values():
        os.close(other)
    signal.set_wakeup_fd(-1)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for output in (1, 2):
        os.dup2(nowhere, output)


def _reap(reading: dict[int, int]) -> None:
    for process, answer in list(reading.items()):
        done, status, usage = os.wait4(process, os.WNOHANG)
        if done == 0:
            continue
        del reading[process]
        end = {
            "signal": os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0,
            "cpu_s": usage.ru_utime + usage.ru_stime,
            "memory_bytes": usage.ru_maxrss * 1024,
        }
        with suppress(OSError):  # nobody waits for it any more
            os.write(answer, json.dumps(end).encode() + b"\n")
        os.close(answer)


if __name__ == "__main__":
    main(sys.argv[1:])
