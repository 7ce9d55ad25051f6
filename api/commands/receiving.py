"""Subcommands of what is received: recordings from files or a live bus, chunks, corrections, quarantine."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from estimation.errors import ParameterError
from estimation.values.reasons import ReasonCode
from estimation.values.runs import SubjectKind
from fleet_db.records import ChunkState, RecordingAction
from ingest.logs import SUFFIXES

if TYPE_CHECKING:
    from api.terminal.live import LiveBus

_HealthHost = Annotated[str, typer.Option(help="Address of the health port.")]
_Bus = Annotated[
    list[str] | None,
    typer.Option(help="CHANNEL=VEHICLE of --interface, in place of --channel and --vehicle. May be repeated."),
]
_Interface = Annotated[str | None, typer.Option(help="Listen to a live bus: virtual, udp_multicast or socketcan.")]
_Exchange = Annotated[
    list[Path] | None,
    typer.Option(help="Exchange of simulated or measured runs: a TOML file beside its table. May be repeated."),
]


def ingest(
    files: Annotated[
        list[Path] | None, typer.Argument(help=f"Recordings ({', '.join(SUFFIXES)}), or folders of them.")
    ] = None,
    *,
    vehicle: Annotated[
        str | None, typer.Option(help="Vehicle of the recordings; by default the part of the file name before '__'.")
    ] = None,
    registry: Annotated[
        Path | None, typer.Option(help="Registry to load first: fleets, vehicles, wheelsets, sections.")
    ] = None,
    interface: _Interface = None,
    channel: Annotated[str | None, typer.Option(help="Channel of the live bus, such as 239.74.163.2 or can0.")] = None,
    bus: _Bus = None,
    exchange: _Exchange = None,
    catalogue: Annotated[
        list[Path] | None,
        typer.Option(help="Mapping file of a bus of your own, beside its DBC file; by default TREADWATCH_CATALOGUES."),
    ] = None,
    take_deleted: Annotated[
        bool, typer.Option("--take-deleted", help="Take recordings in again that were deleted.")
    ] = False,
    chunk_seconds: Annotated[float, typer.Option(min=1.0, help="Length of a recording cut from a live bus.")] = 60.0,
    health_port: Annotated[
        int | None, typer.Option(min=0, max=65535, help="Serve /healthz, /readyz and /metrics of a live bus here.")
    ] = None,
    health_host: _HealthHost = "127.0.0.1",
) -> None:
    """Receive CAN recordings of vehicles, from log files or a live bus, and cut them into windows.

    Every recording is stored unchanged before it is decoded. Receiving a recording twice changes nothing. Runs from a
    simulation or of an instrumented vehicle come in as exchanges. What a live bus sends is on the disk within a second.
    """
    sources = (interface is not None) + bool(files) + bool(exchange)
    if sources > 1 or (sources == 0 and registry is None):  # a registry may come alone
        reason = "give recordings, or --exchange, or --interface with --channel and --vehicle, or --bus"
        raise ParameterError(reason, field="FILES")
    from api.terminal.health_server import HealthAddress
    from api.terminal.ingest import ingest_and_report
    from api.terminal.live import receive_and_report

    if exchange and vehicle is not None:
        raise ParameterError("an exchange names its vehicle itself", field="--vehicle")
    if interface is None:
        ingest_and_report(files or (), exchange or (), vehicle, registry, catalogue or (), take_deleted=take_deleted)
        return
    buses = _buses(interface, channel, vehicle, bus or (), chunk_seconds)
    health = None if health_port is None else HealthAddress(health_host, health_port)
    receive_and_report(buses, registry, catalogue or (), health)


def _buses(
    interface: str, channel: str | None, vehicle: str | None, more: Sequence[str], chunk_seconds: float
) -> list[LiveBus]:
    from api.terminal.live import LiveBus

    if more and (channel is not None or vehicle is not None):
        raise ParameterError("names channel and vehicle itself: leave --channel and --vehicle out", field="--bus")
    if not more and (channel is None or vehicle is None):
        raise ParameterError("a live bus needs --channel and --vehicle, or --bus CHANNEL=VEHICLE", field="--interface")
    pairs = [pair.partition("=")[::2] for pair in more] or [(channel or "", vehicle or "")]
    if not all(bus and of for bus, of in pairs):
        raise ParameterError("is CHANNEL=VEHICLE, such as can0=L-1", field="--bus")
    if min(len({bus for bus, _ in pairs}), len({of for _, of in pairs})) < len(pairs):
        raise ParameterError("a channel or a vehicle is there twice", field="--bus")
    return [LiveBus(interface, bus, of, chunk_seconds) for bus, of in pairs]


chunk = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


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
    from api.terminal.chunks import watch

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
    health_host: _HealthHost = "127.0.0.1",
) -> None:
    """Consume the Kafka topic of references to chunks: each gets its receipt where it has none, and is decoded.

    Any number of these may run; they share the partitions of TREADWATCH_KAFKA_TOPIC.
    """
    from api.terminal.chunks import consume
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


FORMATS = ["%Y-%m-%dT%H:%M:%S%z", "%Y-%m-%dT%H:%M:%S.%f%z", "%Y-%m-%d"]


def reassemble(
    *,
    vehicle: Annotated[str, typer.Option(help="Vehicle whose windows are made again.")],
    begin: Annotated[
        datetime | None,
        typer.Option("--from", formats=FORMATS, help="From this time of its clock, as in 2024-01-08T05:30:00Z."),
    ] = None,
    end: Annotated[datetime | None, typer.Option("--to", formats=FORMATS, help="To this time of its clock.")] = None,
) -> None:
    """Make the windows of a vehicle again from its recordings, the registry and the catalogue, and check their files.

    What is as it should be stays. Windows that changed wait to be estimated again; lost or damaged files are written
    again.
    """
    from api.terminal.ingest import reassemble_and_report

    reassemble_and_report(vehicle, begin, end)


recordings = typer.Typer(no_args_is_help=True, rich_markup_mode=None)

_Digest = Annotated[str, typer.Argument(metavar="DIGEST", help="Digest of the recording, or the begin of it.")]
_Why = Annotated[str, typer.Option(help="Why; kept with the change.")]
_Actor = Annotated[str, typer.Option("--by", help="Who; by default the user of the system.")]


@recordings.command("list")
def list_recordings(
    *,
    state: Annotated[ChunkState | None, typer.Option(help="Only those in this state.")] = None,
    vehicle: Annotated[str | None, typer.Option(help="Only those of this vehicle.")] = None,
    fleet: Annotated[str | None, typer.Option(help="Only those of vehicles of this fleet.")] = None,
    code: Annotated[ReasonCode | None, typer.Option("--reason", help="Only those with this reason code.")] = None,
    limit: Annotated[int, typer.Option(min=1, help="At most so many, the newest.")] = 100,
) -> None:
    """List recordings, the newest first; deleted ones with --state deleted only."""
    from api.terminal.recordings import recording_list
    from fleet_db.stores.chunks import ChosenChunks

    chosen = ChosenChunks(state=state, vehicle=vehicle, fleet=fleet, code=code)
    typer.echo(recording_list(chosen, limit))


@recordings.command("show")
def show_recording(digest: _Digest) -> None:
    """Show the receipt of a recording, and what was done to it by hand."""
    from api.terminal.recordings import recording_text

    typer.echo(recording_text(digest))


@recordings.command("retry")
def retry_recording(
    digest: _Digest,
    *,
    clock_was_behind: Annotated[
        bool, typer.Option("--clock-was-behind", help="Our clock was behind at its receipt, and is right now.")
    ] = False,
    why: _Why = "",
    actor: _Actor = "",
) -> None:
    """Decode a recording again that was rejected, or that failed before; its time of receipt stays."""
    from api.terminal.corrections import correct_and_report

    correct_and_report(RecordingAction.RETRY, digest, actor, why, our_clock_was_behind=clock_was_behind)


@recordings.command("set-aside")
def set_aside_recording(digest: _Digest, *, why: _Why, actor: _Actor = "") -> None:
    """Let a recording count for no window any more; its bytes stay."""
    from api.terminal.corrections import correct_and_report

    correct_and_report(RecordingAction.SET_ASIDE, digest, actor, why)


@recordings.command("restore")
def restore_recording(digest: _Digest, *, why: _Why, actor: _Actor = "") -> None:
    """Let a recording count again that was set aside."""
    from api.terminal.corrections import correct_and_report

    correct_and_report(RecordingAction.RESTORE, digest, actor, why)


@recordings.command("reassign")
def reassign_recording(
    digest: _Digest,
    *,
    vehicle: Annotated[str, typer.Option(help="The vehicle that it is of.")],
    why: _Why,
    actor: _Actor = "",
) -> None:
    """Give a recording to the vehicle that it is of; the windows of both are made again."""
    from api.terminal.corrections import correct_and_report

    correct_and_report(RecordingAction.REASSIGN, digest, actor, why, vehicle)


@recordings.command("delete")
def delete_recording(digest: _Digest, *, why: _Why, actor: _Actor = "") -> None:
    """Make everything as if a recording had never come: its bytes and windows go, its receipt stays and says so."""
    from api.terminal.corrections import correct_and_report

    correct_and_report(RecordingAction.DELETE, digest, actor, why)


quarantine = typer.Typer(no_args_is_help=True, rich_markup_mode=None)


@quarantine.command("list")
def list_quarantine(
    *, everything: Annotated[bool, typer.Option("--all", help="Also what has succeeded since.")] = False
) -> None:
    """List what failed, with its reason code, how often, and when it is tried again."""
    from api.terminal.recordings import quarantine_list

    typer.echo(quarantine_list(everything=everything))


@quarantine.command("retry")
def retry_quarantine(
    kind: Annotated[SubjectKind | None, typer.Argument(help="Only this kind.")] = None,
    key: Annotated[str | None, typer.Argument(help="Only this one of that kind.")] = None,
) -> None:
    """Decode recordings in quarantine now, and let the next run of the jobs try the rest."""
    from api.terminal.corrections import retry_and_report

    retry_and_report(kind, key)
