"""The feed on a terminal: a line an event, and the cursor in a file once the line is out."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

import orjson

from estimation.errors import InputError
from fleet_db.atomic_files import write_atomically

LONGEST_CURSOR = 4096
Event = dict[str, Any]


def read_state(file: Path | None) -> str | None:
    """Return the cursor that an earlier call kept; None where there is none."""
    if file is None or not file.exists():
        return None
    try:
        text = file.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"cannot be read: {error}", file=str(file)) from None
    if not text or len(text) > LONGEST_CURSOR or not text.replace("-", "").replace("_", "").isalnum():
        raise InputError("holds no cursor of the feed; name another file, or remove it to begin again", file=str(file))
    return text


@dataclass(slots=True)
class Lines:
    """Prints events, for people or as JSON, and keeps the cursor behind them in a file; ``state`` None keeps none."""

    as_json: bool
    state: Path | None
    output: TextIO = sys.stdout
    errors: TextIO = sys.stderr
    _kept: str | None = None

    def event(self, event: Event, cursor: str) -> None:
        """Print an event, then keep its cursor."""
        self._print(orjson.dumps(event).decode() if self.as_json else readable(event))
        self.moved(cursor)

    def moved(self, cursor: str) -> None:
        """Keep a cursor."""
        if self.state is not None and cursor and cursor != self._kept:
            write_atomically(self.state, cursor.encode("ascii") + b"\n", durable=True)
            self._kept = cursor

    def restored(self, reason: str, open_now: Sequence[Event], cursor: str | None) -> None:
        """Say that what follows is another history, and what is open now in it."""
        identities = [alert["id"] for alert in open_now]
        if self.as_json:
            self._print(orjson.dumps({"event": "restored", "detail": reason, "open_alerts": identities}).decode())
        else:
            listed = ", ".join(map(str, identities)) or "none"
            self._print(f"restored: {reason}; alerts open now: {listed}")
        self.moved(cursor or "")

    def waiting(self, reason: str) -> None:
        """Say on the side why nothing comes."""
        print(f"treadwatch: {reason}", file=self.errors, flush=True)

    def _print(self, line: str) -> None:
        print(line, file=self.output, flush=True)


def readable(event: Event) -> str:
    """Return the line of an event for people, with control characters shown and not sent."""
    alert = event["alert"]
    subject = alert["wheelset"] or f"fleet {alert['fleet']}"
    line = f"{event['recorded_at']}  {event['event']:<12}  {alert['id']:>6}  {alert['severity']:<8}  {alert['kind']}"
    line = f"{line}  {subject}" + (f"  by {event['actor']}" if event["actor"] != "treadwatch" else "")
    line += f"  {event['note']}" if event["note"] else ""
    return "".join(one if one.isprintable() else repr(one)[1:-1] for one in line)
