"""``treadwatch worker``: worker processes of this machine for a Dask scheduler."""

from __future__ import annotations

from api.commands.worker_options import DaskScheduler, Workers


def worker(*, workers: Workers = None, dask_scheduler: DaskScheduler = None) -> None:
    """Let processes of this machine work for a Dask scheduler; each has the settings of this environment."""
    import threading
    from functools import partial

    from api import logs
    from api.factory import once_the_database_answers, open_store
    from api.settings import load_settings
    from api.workers.dask_worker import serve_dask
    from estimation.errors import ParameterError
    from estimation.jobs.stop_signals import stop_on_signals

    settings = load_settings(workers=workers, dask_scheduler=dask_scheduler)
    if settings.dask_scheduler is None:
        raise ParameterError("is needed: the address of the Dask scheduler", field="--dask-scheduler")
    logs.configure(settings)
    stopping = threading.Event()
    stop_on_signals(stopping)
    opened = once_the_database_answers(partial(open_store, settings), settings, stopping)
    if opened is not None:
        opened.close()
        serve_dask(settings.dask_scheduler, settings, stopping)
