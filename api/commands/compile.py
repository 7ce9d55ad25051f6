"""``treadwatch compile``: machine code of every compiled function, before the first start needs it."""

from __future__ import annotations

import time

import typer

from estimation.errors import StorageError


def compile_kernels() -> None:
    """Compile every kernel into TREADWATCH_COMPILED_DIR, or load what is already there."""
    from api.kernel_runs import results
    from estimation.compiled import COUNTS, directories

    started = time.process_time()
    results()
    if COUNTS.not_kept:
        raise StorageError(f"{directories()[0]}: {COUNTS.not_kept} compiled functions could not be written")
    typer.echo(
        f"{COUNTS.compiled} compiled, {COUNTS.loaded} already there, {time.process_time() - started:.1f} s of CPU"
    )
