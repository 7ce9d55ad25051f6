"""A stop that is requested while the main thread looks whether one is requested."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

pytestmark = pytest.mark.slow

ROUNDS = 1500
PROGRAM = textwrap.dedent(
    """
    import random, signal, sys, threading
    from estimation.jobs.scheduler import stop_on_signals

    def work():
        while True:
            sum(range(50))

    sys.setswitchinterval(1e-6)  # the main thread is interrupted wherever it may be
    for _ in range(2):
        threading.Thread(target=work, daemon=True).start()
    for _ in range(int(sys.argv[1])):
        stop = threading.Event()
        stop_on_signals(stop)
        signal.signal(signal.SIGALRM, signal.getsignal(signal.SIGTERM))
        signal.setitimer(signal.ITIMER_REAL, 1e-5 + 2e-3 * random.random())
        while not stop.wait(1e-7):
            pass
    print("stopped", sys.argv[1])
    """
)


def test_a_signal_at_any_moment_of_waiting_stops() -> None:
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(ROUNDS)], capture_output=True, text=True, timeout=120.0, check=False
    )
    assert done.stdout == f"stopped {ROUNDS}\n", done.stderr
