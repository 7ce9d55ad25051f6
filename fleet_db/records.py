"""What is kept beside results, as values: receipts, decisions on the registry, keys and their use, webhooks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

from estimation.values.fields import JsonValue, Served
from estimation.values.reasons import Reason


class ChunkState(StrEnum):
    """Where a recording stands on its way to windows."""

    STORED = "stored"  # its bytes are safe
    DECODED = "decoded"
    REJECTED = "rejected"
    SET_ASIDE = "set_aside"  # by hand: its frames count for no window
    DELETED = "deleted"  # by hand: as if it had never come; its receipt stays, its bytes do not


@dataclass(frozen=True, slots=True)
class ChunkRecord:
    """The receipt of a recording: raw bytes are stored under their digest before this row is committed."""

    digest: Annotated[str, Served("SHA-256 of its bytes: its identity.", example="ab" * 32)]
    vehicle: Annotated[str, Served("Code of the vehicle that it came for; it need not be registered.")]
    suffix: Annotated[str, Served("Ending of its format.", "format", example=".blf")]
    size_bytes: Annotated[int, Served("Of its bytes as they came.")]
    state: ChunkState
    reason: Reason | None
    first_ns: Annotated[int | None, Served("First frame, on the vehicle's clock; null until decoded.", "measured_from")]
    last_ns: Annotated[int | None, Served("Last frame, on the vehicle's clock; null until decoded.", "measured_to")]
    frames: int
    counts: Mapping[str, int]  # marked and counted: unknown identifiers, wrong lengths, gaps, clipped, invalid ...
    received_ns: Annotated[int, Served("When its receipt was given, by our clock.")]
    recorded_ns: int
    purged_ns: Annotated[
        int | None, Served("When its raw bytes were removed; null while they are kept.", "bytes_removed_at")
    ] = None
    clock_checked_ns: int | None = None  # our time against which the vehicle's is checked where received_ns was wrong
    file_name: Annotated[str | None, Served("Under which it came.")] = None
    sender: str | None = None  # who sent it where it came by HTTP or through a drop folder


@dataclass(frozen=True, slots=True)
class EstimatedAgain:
    """What is estimated again because the class of vehicles, or the nominal radius of a wheelset, has changed."""

    subjects: tuple[str, ...] = ()  # codes of the vehicles, or the wheelset, of which something is
    windows: int = 0  # how many of their windows; 0 where only geometries are
    from_ns: int | None = None  # start of the oldest of their windows, on the vehicle's clock; None where there is none
    sections: tuple[str, ...] = ()  # codes of the sections that they helped to align


NOTHING_AGAIN = EstimatedAgain()


class RecordingAction(StrEnum):
    """What is done to a recording by hand."""

    RETRY = "retry"
    SET_ASIDE = "set_aside"
    RESTORE = "restore"
    REASSIGN = "reassign"
    DELETE = "delete"
    TAKE_AGAIN = "take_again"  # received again after it had been deleted, because that was asked for


@dataclass(frozen=True, slots=True)
class RecordingChange:
    """What was done to a recording by hand: when (our time), by whom and why, and how it stood before and after."""

    digest: str
    action: Annotated[RecordingAction, Served("What was done.")]
    recorded_ns: Annotated[int, Served("When, by our clock.", "at")]
    actor: Annotated[str, Served("Who.", "by")]
    why: Annotated[str, Served("As it was written.")]
    vehicle_before: Annotated[str, Served("Code of its vehicle before it.")]
    state_before: Annotated[ChunkState, Served("Its state before it.")]
    vehicle_after: Annotated[str, Served("Code of its vehicle after it.")]
    state_after: Annotated[ChunkState, Served("Its state after it.")]


@dataclass(frozen=True, slots=True)
class RawScrub:
    """One reading: begin and end (ns of our clock; None while it is not whole), the last digest, and what was found."""

    scrub_id: int
    started_ns: int
    finished_ns: int | None
    after_digest: str
    files: int
    file_bytes: int
    faults: int


class RecordKind(StrEnum):
    """Records of the registry whose history is kept."""

    MOUNTING = "mounting"  # of a wheelset, from a time
    REPROFILING = "reprofiling"  # of a wheelset, at a time
    MEASUREMENT = "measurement"  # of the profiles of a wheelset, at a time
    WHEELSET = "wheelset"
    SECTION = "section"
    VEHICLE = "vehicle"
    VEHICLE_CLASS = "vehicle_class"
    SENSOR_CHANGE = "sensor_change"  # at an axle of a vehicle, at a time

    @property
    def dated(self) -> bool:
        """Whether a time belongs to its key."""
        return self in {RecordKind.MOUNTING, RecordKind.REPROFILING, RecordKind.MEASUREMENT, RecordKind.SENSOR_CHANGE}


class RecordAction(StrEnum):
    """What was done to a record."""

    ENTERED = "entered"
    CHANGED = "changed"
    VOIDED = "voided"
    RESTORED = "restored"


@dataclass(frozen=True, slots=True)
class Decision:
    """Who decides on a record, why, and when by our clock; None where that is not known."""

    actor: str = ""
    reason: str = ""
    recorded_ns: int | None = None


@dataclass(frozen=True, slots=True)
class RegistryEvent:
    """One decision on a record."""

    id: int  # in the order of the decisions
    kind: RecordKind
    subject: str  # wheelset, vehicle, class or section of the record
    at_ns: int | None  # on the vehicle's clock, where it belongs to the key of the record
    action: RecordAction
    actor: str  # empty where a registry file changed it, as the reason
    reason: str
    record: Mapping[str, JsonValue]  # before it was changed or voided, or what was restored; empty where it is new
    recorded_ns: int | None  # our time; None where it is not known
    after: Mapping[str, JsonValue] | None = None  # where it was entered or changed


@dataclass(frozen=True, slots=True)
class ApiKey:
    """What is kept of a key, not its secret: ``digest`` is the SHA-256 of the whole key, 256 random bits."""

    prefix: Annotated[str, Served("Its public part, by which it is found.", example="3fq2xh7a")]
    digest: str
    owner: Annotated[str, Served("Who it was given to; recorded with what is done with it.", example="depot west")]
    scopes: frozenset[str]
    fleets: Annotated[
        frozenset[str] | None, Served("Codes of the fleets that it sees; null is all fleets.", example=["alpha"])
    ]
    created_ns: Annotated[int, Served("When it was made.")]
    created_by: Annotated[str, Served("Who made it.")]
    expires_ns: Annotated[int | None, Served("When it expires; null is never.")] = None
    revoked_ns: Annotated[int | None, Served("When it was revoked; null while it is not.")] = None
    last_used_ns: Annotated[
        int | None, Served("When it was used last, to a minute; null is never.", "last_used_at")
    ] = None

    def usable(self, now_ns: int) -> bool:
        """Return whether it is neither revoked nor expired."""
        return self.revoked_ns is None and (self.expires_ns is None or now_ns < self.expires_ns)


@dataclass(frozen=True, slots=True)
class AuditEntry:
    """One change, or one request that was refused for want of a right."""

    at_ns: Annotated[int, Served("When, on the server's clock.", "recorded_at")]
    owner: Annotated[str | None, Served("Owner of the key or token; null where none was known.")]
    key_prefix: Annotated[str | None, Served("Prefix of the key; null where it was none.")]
    method: Annotated[str, Served("Of the request; `keys` for the command line.", example="POST")]
    path: Annotated[str, Served("Of the request.", example="/v1/alerts/1/acknowledge")]
    status: Annotated[int, Served("Of the answer; 0 for the command line.", example=200)]
    object: Annotated[str | None, Served("Path of what was changed or made.", example="/v1/alerts/1/acknowledge")]
    address: Annotated[str | None, Served("Where the request came from.", example="192.0.2.7")]
    request_id: Annotated[str | None, Served("Name of the request in the log.")]
    entry_id: Annotated[int, Served(name="id")] = 0


class WebhookState(StrEnum):
    """Whether a webhook is delivered to."""

    ACTIVE = "active"
    PAUSED = "paused"
    DISABLED = "disabled"


class DisabledReason(StrEnum):
    """Why a webhook was disabled."""

    GONE = "gone"
    FAILING = "failing"


class DeliveryState(StrEnum):
    """What became of an event that was sent to a webhook."""

    WAITING = "waiting"
    DELIVERED = "delivered"
    FAILED = "failed"
    WITHDRAWN = "withdrawn"


class Failure(StrEnum):
    """Why an attempt failed."""

    UNKNOWN_HOST = "unknown_host"
    REFUSED_ADDRESS = "refused_address"
    UNREACHABLE = "unreachable"
    TLS = "tls"
    TIMEOUT = "timeout"
    NO_HTTP = "no_http"
    REDIRECT = "redirect"
    STATUS = "status"
    GONE = "gone"
    NOT_SENT = "not_sent"


@dataclass(frozen=True, slots=True)
class Webhook:
    """Where events of the feed are sent, without its secrets; empty sets of fleets, kinds and severities are all."""

    webhook_id: Annotated[int, Served(name="id")]
    url: str
    description: str
    fleets: frozenset[str]
    kinds: frozenset[str]
    severities: frozenset[str]
    bound: Annotated[
        frozenset[str] | None,
        Served("Fleets of the key that made it: it never carries an event of another. Null is all.", "bound_to"),
    ]
    state: Annotated[WebhookState, Served("Whether it is sent to; a disabled one is sent to again once it is active.")]
    disabled_reason: Annotated[
        DisabledReason | None,
        Served(
            "`gone`: its receiver answered 410. `failing`: an event was not taken until it was given up. "
            "Null while it is not disabled."
        ),
    ]
    since_ns: Annotated[int, Served("Since when it is in this state.", "state_since")]
    created_ns: Annotated[int, Served("When it was made.")]
    created_by: Annotated[str, Served("Who made it.", example="depot west")]
    position: int  # number of the event up to which everything is delivered, or is none of its events
    revision: int = 1


@dataclass(frozen=True, slots=True)
class Delivery:
    """An event on its way to a webhook."""

    delivery_id: Annotated[int, Served(name="id")]
    webhook_id: int
    sequence: int
    event_id: Annotated[str, Served("Id of the event, the same at every attempt.")]
    event_kind: str
    alert_id: int
    event_ns: Annotated[int, Served("When the event was recorded.", "event_recorded_at")]
    state: Annotated[
        DeliveryState,
        Served(
            "`waiting` for its next attempt; `delivered`; `failed`: given up, and its webhook is disabled; "
            "`withdrawn`: its webhook was changed before it was taken."
        ),
    ]
    attempts: Annotated[int, Served("How often it was sent.", example=1)]
    first_ns: Annotated[int, Served("When it was sent first.", "first_attempt_at")]
    last_ns: Annotated[int, Served("When it was sent last.", "last_attempt_at")]
    next_ns: Annotated[int | None, Served("When it is sent again; null where it is not.", "next_attempt_at")]
    status_code: Annotated[int | None, Served("Status of the last answer; null without one.", example=204)]
    failure: Annotated[Failure | None, Served("Why the last attempt failed; null where it did not.", "reason_code")]
    detail: Annotated[str | None, Served("The same as a sentence.", "reason")]


@dataclass(frozen=True, slots=True)
class WebhookCount:
    """How often a webhook was delivered to, and how often an attempt failed, since it was made."""

    webhook: Webhook
    delivered: int
    failed: int
