"""What the test of access sends to each operation; a new operation of a new shape needs an example here.

The database is that of ``api_fleet``, whose fleets are foreign to the caller, and a fleet of the caller's own. Each
identifier of a foreign object has one beside it that names nothing: the answers to both must be the same.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import api_fleet
import populated_fleet

from estimation.values.registry import FleetRecord, Mounting, VehicleRecord
from estimation.values.runs import JobOutcome, JobTrigger
from fleet_db.records import ChunkRecord, ChunkState, Webhook, WebhookState
from fleet_db.storage import SqlStorage

FLEET, VEHICLE, WHEELSET, ALERT = "own", "OWN-V", "OWN-WS", "own alert"
FOREIGN_ALERT = "foreign alert"
WEBHOOK, FOREIGN_WEBHOOK = "own webhook", "foreign webhook"
MARKERS = re.compile(rb"cdcdcdcd|WS-0\d\d|\bV-[0-2]\b|alpha|=beta|Alpha railway|=1\+1")
"""Whatever stands in the database of the foreign fleets and nowhere else."""


@dataclass(frozen=True)
class Named:
    """An object of a foreign fleet, a name of nothing, and an object of the caller's own."""

    foreign: str
    missing: str
    own: str


PATHS: Mapping[str, Named | str] = {
    "/v1/alerts/{alert_id}": Named(FOREIGN_ALERT, "987654321", ALERT),
    "/v1/fleets/{code}": Named("alpha", "gamma", FLEET),
    "/v1/chunks/{sha256}": Named("cd" * 32, "ef" * 32, "12" * 32),
    "/v1/recordings/{digest}": Named("cd" * 32, "ef" * 32, "12" * 32),
    "/v1/vehicles/{code}": Named("V-0", "V-9", VEHICLE),
    "/v1/webhooks/{webhook_id}": Named(FOREIGN_WEBHOOK, "987654321", WEBHOOK),
    "/v1/wheelsets/{serial}": Named("WS-000", "WS-999", WHEELSET),
    "/v1/jobs/{name}": "estimate_windows",
    "/v1/job-runs/{run_id}": "1",
    "/v1/keys/{prefix}": "aaaaaaaa",
    "/v1/track-sections/{code}": "S-3",
    "/v1/vehicle-classes/{code}": "regional",
}
"""How a path begins, and what stands in it; a plain text is shared by all fleets, or of none."""
DEEPER: Mapping[str, str] = {"measured_at": "2025-06-20T15:06:40Z"}
"""Parameters behind the first, each under its name."""
FILTERS: Mapping[str, Named] = {
    "fleet": Named("alpha", "gamma", FLEET),
    "vehicle": Named("V-0", "V-9", VEHICLE),
    "wheelset": Named("WS-000", "WS-999", WHEELSET),
    "of": Named("WS-000", "WS-999", WHEELSET),
    "fleet_alert": Named(FOREIGN_ALERT, "987654321", ALERT),
}
"""Query parameters that name an object."""
NAMING_NOTHING = frozenset(
    [
        "after",
        "alert_kind",
        "alert_severity",
        "as_of",
        "at",
        "condition",
        "cursor",
        "file_name",
        "format",
        "from",
        "key_prefix",
        "kind",
        "limit",
        "method",
        "open",
        "owner",
        "reason_code",
        "received_from",
        "received_to",
        "severity",
        "wait_s",
        "why",
        "by",
        "scope",
        "sort",
        "state",
        "status",
        "to",
        "urgency",
        "vehicle_class",
        "version",
        "horizon_days",
        "together_days",
        "nominal_radii",
        "cut_mm",
        "minimum_radius_mm",
        "axle_difference_mm",
        "bogie_difference_mm",
        "vehicle_difference_mm",
    ]
)
"""Query parameters that name no object of a fleet."""
QUERIES: Mapping[str, Mapping[str, str]] = {"put_chunk": {"vehicle": "V-0", "format": "blf"}}
"""Parameters that an operation requires; they name foreign objects wherever they can."""
BODIES: Mapping[str, Mapping[str, object]] = {
    "acknowledge_alert": {"note": "seen"},
    "add_external_ref": {"ref": "maximo:1"},
    "add_measured_profiles": {"measured_at": "2025-07-20T00:00:00Z"},
    "add_reprofiling": {"reprofiled_at": "2025-07-20T00:00:00Z", "mileage_km": 10.0},
    "add_sensor_change": {"axle": 1, "worked_at": "2025-07-20T00:00:00Z", "work": "swap"},
    "add_vehicle": {
        "code": "V-0",
        "fleet": "alpha",
        "vehicle_class": "regional",
        "axles": 1,
        "max_speed_km_h": 160.0,
        "axle_offsets_m": [0.0],
    },
    "add_vehicle_class": {"text": ""},
    "add_wheelset": {"serial": "WS-001", "fleet": "alpha", "wheel_profile": "P8", "nominal_radius_mm": 437.5},
    "change_vehicle": {
        "fleet": "alpha",
        "vehicle_class": "regional",
        "axles": 1,
        "max_speed_km_h": 160.0,
        "axle_offsets_m": [0.0],
    },
    "change_wheelset": {"fleet": "alpha", "wheel_profile": "P8", "nominal_radius_mm": 437.5},
    "restore_record": {"kind": "wheelset", "key": "WS-001", "reason": "right"},
    "void_record": {"kind": "wheelset", "key": "WS-001", "reason": "wrong"},
    "create_webhook": {"url": "https://203.0.113.9/hook", "fleets": ["alpha"]},
    "change_webhook": {"fleets": ["alpha"]},
    "replay_webhook": {"after": "latest"},
    "rotate_webhook_secret": {"overlap_s": 60},
    "create_key": {"owner": "stranger", "scopes": ["read"], "fleets": ["alpha"]},
    "dismount_wheelset": {"dismounted_at": "2025-07-20T00:00:00Z"},
    "exchange_wheelset": {
        "fitted": "WS-001",
        "exchanged_at": "2025-07-20T00:00:00Z",
        "vehicle_odometer_km": 5000.0,
        "fitted_mileage_km": 9.0,
    },
    "mount_wheelset": {
        "vehicle": "V-0",
        "axle": 4,
        "mounted_from": "2025-07-20T00:00:00Z",
        "vehicle_odometer_km": 5000.0,
        "wheelset_mileage_km": 9.0,
    },
    "reassign_recording": {"why": "another unit", "vehicle": "V-0"},
    "retry_recording": {"why": "again"},
    "shelve_alert": {"until": "2100-01-01T00:00:00Z", "reason": "later"},
    "unshelve_alert": {"note": "again"},
}
"""A body of every operation that takes one; it names foreign objects wherever it can name any."""
NOWHERE: Mapping[str, str] = {"WS-001": "WS-998", "V-0": "V-9", "alpha": "gamma"}
"""Names of nothing for the foreign names in the bodies."""
WITHOUT_NAMES = frozenset(
    [
        "acknowledge_alert",
        "add_external_ref",
        "add_measured_profiles",
        "add_reprofiling",
        "add_sensor_change",
        "add_vehicle_class",
        "dismount_wheelset",
        "replay_webhook",
        "rotate_webhook_secret",
        "retry_recording",
        "shelve_alert",
        "unshelve_alert",
    ]
)
"""Operations whose body names no object."""


def populate(storage: SqlStorage) -> Mapping[str, str]:
    """Store the foreign fleets and the caller's own; return the numbers of the alerts."""
    populated_fleet.populate(storage)
    _own(storage)
    with storage.write() as unit:
        run = unit.jobs.start("estimate_windows", JobTrigger.SCHEDULE, api_fleet.RECORDED + 100)[0]
        unit.jobs.finish(run.run_id, JobOutcome.FAILED, {"estimated": 3}, api_fleet.RECORDED + 200, "WS-000 of alpha")
    own = api_fleet.raised(storage, WHEELSET, fleet=FLEET)
    foreign = api_fleet.raised(storage, "WS-000")
    numbers = {ALERT: str(own.alert_id), FOREIGN_ALERT: str(foreign.alert_id)}
    return numbers | {WEBHOOK: paused_webhook(storage, FLEET), FOREIGN_WEBHOOK: paused_webhook(storage, "alpha")}


def paused_webhook(storage: SqlStorage, fleet: str, state: WebhookState = WebhookState.PAUSED) -> str:
    """Store a webhook, paused unless another state is given, of a key that is bound to a fleet; return its number."""
    at_ns = api_fleet.RECORDED
    bound = frozenset({fleet})
    with storage.write() as unit:
        one = Webhook(
            0, "https://203.0.113.9/", fleet, bound, *(frozenset(),) * 2, bound, state, None, *(at_ns,) * 2, "", 0
        )
        return str(unit.webhooks.add(one, "whsec_c2VjcmV0").webhook_id)


def _own(storage: SqlStorage) -> None:
    record = api_fleet.wheelset(20)
    mounting = Mounting(WHEELSET, VEHICLE, 1, api_fleet.START, None, 1.0, 2.0)
    with storage.write() as unit:
        unit.registry.add_fleet(FleetRecord(FLEET, "Own railway"))
        unit.registry.add_vehicle(VehicleRecord(VEHICLE, FLEET, "regional", 4, 44.5, (0.0, 2.5, 17.0, 19.5)))
        for digest, vehicle in (("cd" * 32, "V-0"), ("12" * 32, VEHICLE)):
            state, at_ns = ChunkState.DECODED, api_fleet.RECORDED
            unit.chunks.put(ChunkRecord(digest, vehicle, ".log", 1, state, None, 1, 2, 1, {}, at_ns, at_ns))
        unit.registry.add_wheelset(replace(record, serial=WHEELSET, fleet=FLEET, mounting=mounting))
