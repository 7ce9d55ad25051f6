"""A stop that is requested while the main thread waits."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap

PROGRAM = textwrap.dedent(
    """
    import signal, threading
    from api.terminal.stopping import stop_on_signals

    def elsewhere():  # as where the signal comes just before the main thread waits
        signal.pthread_kill(threading.get_ident(), signal.SIGTERM)

    stop = threading.Event()
    stop_on_signals(stop)
    threading.Timer(0.2, elsewhere).start()
    print(stop.wait(20.0))
    """
)


def test_a_signal_that_does_not_wake_the_main_thread_stops() -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, timeout=120.0, check=False)
    assert done.stdout == "True\n", done.stderr


FORKED = textwrap.dedent(
    """
    import os, signal, threading
    from api.terminal.stopping import stop_on_signals

    stop = threading.Event()
    stop_on_signals(stop)
    ready, say = os.pipe()
    child = os.fork()
    if child == 0:
        os.write(say, b"1")
        signal.pause()
        os._exit(0)
    os.read(ready, 1)
    os.kill(child, signal.SIGTERM)
    _, status = os.waitpid(child, 0)
    print(os.WTERMSIG(status), stop.wait(0.5))
    """
)


def test_a_signal_to_a_child_that_was_forked_ends_it_alone() -> None:
    done = subprocess.run([sys.executable, "-c", FORKED], capture_output=True, text=True, timeout=120.0, check=False)
    assert done.stdout == f"{signal.SIGTERM.value} False\n", done.stderr
