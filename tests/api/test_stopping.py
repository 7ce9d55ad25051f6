"""A stop that is requested while the main thread waits."""

from __future__ import annotations

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
