"""The thread that delivers to webhooks, in whichever process of a deployment holds the lock; the others wait for it."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import threading
from collections.abc import Callable
from dataclasses import replace

from api.services import Services
from api.webhooks.delivering import Deliveries
from api.webhooks.sending import Sender
from estimation.errors import TreadwatchError
from fleet_db.process_locks import sending_alone
from fleet_db.session import BUSY_TIMEOUT_MS

INTERVAL_S = 1.0
"""Between two looks at what is due."""
TAKE_OVER_S = 5.0
"""Between two looks at whether the process that delivers has ended."""
PATIENCE_S = 3.0
"""How long what is being sent may take when the service ends."""
_log = logging.getLogger(__name__)


class WebhookWorker:
    """Delivers from :meth:`start` to :meth:`stop`, while no other process does.

    Args:
        services: Of the app, where it has them by now.
    """

    def __init__(self, services: Callable[[], Services | None], sender: Sender) -> None:
        self._services = services
        self._sender = sender
        self._holder = f"{socket.gethostname()}, process {os.getpid()}, webhooks"
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin, in a thread."""
        self._thread = threading.Thread(target=self._run, name="webhooks", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End, once what is being sent has been stored or has taken too long."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join(2 * PATIENCE_S)  # a database that is silent must not hold the end up
        self._sender.close()

    def _run(self) -> None:
        wait_s, waits = 0.0, False
        while not self._stopping.wait(wait_s):
            services = self._services()
            wait_s = INTERVAL_S if services is None else TAKE_OVER_S
            if services is None:
                continue
            try:
                with sending_alone(services.storage.engine, self._holder) as still_alone:
                    waits = False
                    if still_alone is not None:
                        asyncio.run(self._deliver(services, still_alone))
            except TreadwatchError as error:
                _log.log(logging.DEBUG if waits else logging.WARNING, "webhooks wait for the database: %s", error)
                waits = True
            except Exception:  # noqa: BLE001 - the thread must outlive what went wrong once
                _log.exception("webhooks are not delivered to for %g s", TAKE_OVER_S)

    async def _deliver(self, services: Services, still_alone: Callable[[], bool]) -> None:
        """Deliver until the service ends, or another process may have taken over."""
        patient = replace(services.storage, patience_s=BUSY_TIMEOUT_MS / 1000)  # requests do not wait for it
        deliveries = Deliveries(patient, self._sender, services.clock)
        try:
            while not self._stopping.is_set() and await asyncio.to_thread(still_alone):
                await deliveries.look()
                await asyncio.to_thread(self._stopping.wait, INTERVAL_S)
        finally:
            await deliveries.end(PATIENCE_S)
