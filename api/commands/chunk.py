"""``treadwatch chunk``: chunks that are handed in, from a drop folder to windows, and their files on the disk."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

chunk = typer.Typer(
    no_args_is_help=True,
    help="Watch a drop folder, decode what is received, consume a Kafka topic, scrub raw files.",
    rich_markup_mode=None,
)


@chunk.command("drop")
def watch_drop_folder(
    folder: Annotated[Path, typer.Argument(help="Folder that logs are put into.")],
    *,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle of all files; by default the part of each name before '__'.")
    ] = None,
    quiet_s: Annotated[
        float, typer.Option(min=0.0, help="A file that has not changed for so long is complete, s.")
    ] = 5.0,
    once: Annotated[bool, typer.Option("--once", help="End when nothing is left that could be taken.")] = False,
) -> None:
    """Store each log of a folder with its receipt once it is complete; move it to done/, or to refused/ with a reason.

    What is stored is decoded by the scheduler or by `treadwatch chunk work`. While too much waits, files stay where
    they are.
    """
    from api.terminal.drop_folder import watch

    watch(folder, vehicle, quiet_s, once=once)


@chunk.command("work")
def decode_chunks(
    *, once: Annotated[bool, typer.Option("--once", help="End when nothing waits any more.")] = False
) -> None:
    """Decode what is received, beside the scheduler; any number of these may run, on any number of machines."""
    from api.terminal.chunks import work

    work(once=once)


@chunk.command("consume")
def consume_references(
    *,
    health_port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Serve /healthz, /readyz and /metrics here.")
    ] = None,
    health_host: Annotated[str, typer.Option(help="Address of the health port.")] = "127.0.0.1",
) -> None:
    """Consume the Kafka topic of references to chunks: each gets its receipt where it has none, and is decoded.

    Any number of these may run; they share the partitions of TREADWATCH_KAFKA_TOPIC.
    """
    from api.terminal.consume import consume
    from api.terminal.health_server import HealthAddress

    consume(None if health_port is None else HealthAddress(health_host, health_port))


@chunk.command("scrub")
def scrub_raw_files(
    *,
    mb_per_s: Annotated[
        float | None, typer.Option("--mb-per-s", min=0.001, help="Read at most so fast; by default as the disk does.")
    ] = None,
    from_the_beginning: Annotated[
        bool, typer.Option("--from-the-beginning", help="Begin again where an earlier scrub was not finished.")
    ] = False,
) -> None:
    """Read every stored recording again and compare it with its digest; damaged and missing ones go into quarantine.

    Exit code 1 where there are any. Interrupted, the next scrub goes on from where it was.
    """
    from api.terminal.chunks import scrub_and_report

    scrub_and_report(mb_per_s, resume=not from_the_beginning)
