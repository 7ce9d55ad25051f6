"""``treadwatch recordings``: list and show what was received, and correct it."""

from __future__ import annotations

from typing import Annotated

import typer

from estimation.values.reasons import ReasonCode
from fleet_db.receipts import ChunkState, RecordingAction

recordings = typer.Typer(no_args_is_help=True, help="List and correct what was received.", rich_markup_mode=None)

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
    from api.terminal.recordings import correct_and_report

    correct_and_report(RecordingAction.RETRY, digest, actor, why, our_clock_was_behind=clock_was_behind)


@recordings.command("set-aside")
def set_aside_recording(digest: _Digest, *, why: _Why, actor: _Actor = "") -> None:
    """Let a recording count for no window any more; its bytes stay."""
    from api.terminal.recordings import correct_and_report

    correct_and_report(RecordingAction.SET_ASIDE, digest, actor, why)


@recordings.command("restore")
def restore_recording(digest: _Digest, *, why: _Why, actor: _Actor = "") -> None:
    """Let a recording count again that was set aside."""
    from api.terminal.recordings import correct_and_report

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
    from api.terminal.recordings import correct_and_report

    correct_and_report(RecordingAction.REASSIGN, digest, actor, why, vehicle)


@recordings.command("delete")
def delete_recording(digest: _Digest, *, why: _Why, actor: _Actor = "") -> None:
    """Make everything as if a recording had never come: its bytes and windows go, its receipt stays and says so."""
    from api.terminal.recordings import correct_and_report

    correct_and_report(RecordingAction.DELETE, digest, actor, why)
