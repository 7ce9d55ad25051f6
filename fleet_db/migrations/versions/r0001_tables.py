"""All tables of the first release."""

from __future__ import annotations

import time
import uuid
from itertools import pairwise
from typing import Any

import sqlalchemy as sa
from alembic import op

from fleet_db.tables.base import NAMING, one_of

revision: str = "r0001"
down_revision: str | None = None
branch_labels: str | None = None
depends_on: str | None = None

TABLES = sa.MetaData(naming_convention=NAMING)
TYPES: dict[str, sa.types.TypeEngine[Any]] = {
    # SQLite numbers rows by itself only in a column declared INTEGER, which there is 64 bits wide as well
    "SERIAL": sa.BigInteger().with_variant(sa.Integer(), "sqlite"),
    "INTEGER": sa.Integer(),
    "BIG": sa.BigInteger(),
    "FLAG": sa.Boolean(),
    "REAL": sa.Double(),
    "CODE": sa.String(64),
    "TEXT": sa.Text(),
    "JSON": sa.JSON(),
    "BLOB": sa.LargeBinary(),
    **{f"S{length}": sa.String(length) for length in (8, 16, 32, 40, 128, 192, 255)},
}
BIN_QUANTITIES = ("rolling_radius_sum", "rolling_radius_difference", "contact_angle_sum", "contact_angle_difference")
DEFAULTS: dict[str, Any] = {"0": sa.text("0"), "false": sa.false()}
Items = list[sa.schema.SchemaItem]


def upgrade() -> None:
    TABLES.create_all(op.get_bind(), checkfirst=False)
    # the identity of this database: until its first restore all events of its feed are of this branch
    branch = {"identity": uuid.uuid4().hex, "after_sequence": 0, "began_ns": time.time_ns()}
    op.bulk_insert(feed_branches, [branch])


def table(name: str, described: str, *parts: Items | sa.schema.SchemaItem, numbered: bool = False) -> sa.Table:
    """Add a table; ``numbered``: SQLite uses no number of a row twice."""
    items = columns(described) + [item for part in parts for item in (part if isinstance(part, list) else [part])]
    return sa.Table(name, TABLES, *items, sqlite_autoincrement=numbered)


def columns(described: str) -> Items:
    """Return columns: ``name TYPE``, and KEY, NULL, UNIQUE, ``DEFAULT 0`` or ``> table.column DELETE CASCADE``."""
    items: Items = []
    for name, kind, *said in (column.split() for column in described.split(",")):
        after = dict(pairwise(said))
        options: dict[str, Any] = {
            "nullable": "NULL" in said,
            "primary_key": "KEY" in said,
            "unique": "UNIQUE" in said or None,
        }
        if "DEFAULT" in after:
            options["server_default"] = DEFAULTS[after["DEFAULT"]]
        on_delete = {"CASCADE": "CASCADE", "NULLED": "SET NULL"}.get(after.get("DELETE", ""))
        to = [sa.ForeignKey(after[">"], ondelete=on_delete)] if ">" in after else []
        items.append(sa.Column(name, TYPES[kind], *to, **options))
    return items


def checks(**conditions: str) -> Items:
    return [sa.CheckConstraint(condition, name=name) for name, condition in conditions.items()]


def known(names: str, values: str) -> Items:
    return [one_of(name, values.split()) for name in names.split()]


def indexes(*names: str) -> Items:
    return [sa.Index(None, *indexed.split()) for indexed in names]


def part(name: str, names: str, condition: str, *, unique: bool = False) -> sa.Index:
    """Return the index of the rows that meet a condition."""
    where = sa.text(condition)
    return sa.Index(name, *names.split(), unique=unique, sqlite_where=where, postgresql_where=where)


def chunks_by_length(first: str, last: str) -> list[sa.Index]:
    """Return an index each of the decoded chunks of up to a minute, up to an hour and longer."""
    short, middle = f"{last} - {first} <= 60000000000", f"{last} - {first} <= 3600000000000"
    lengths = {"short": short, "middle": f"{short.replace('<=', '>')} AND {middle}", "long": middle.replace("<=", ">")}
    return [
        part(f"ix_chunks_{name}_{first}", f"vehicle {first}", f"state = 'decoded' AND {condition}")
        for name, condition in lengths.items()
    ]


table(
    "api_keys",
    "prefix S8 KEY, digest CODE, owner TEXT, scopes JSON, fleets JSON NULL, created_ns BIG, created_by TEXT, "
    "expires_ns BIG NULL, revoked_ns BIG NULL, last_used_ns BIG NULL",
)
table(
    "audit_entries",
    "entry_id SERIAL KEY, at_ns BIG, owner TEXT NULL, key_prefix CODE NULL, method S16, path TEXT, status INTEGER, "
    "object TEXT NULL, address TEXT NULL, request_id CODE NULL",
    indexes("at_ns", "key_prefix entry_id"),
    numbered=True,
)
table(
    "window_adhesion",
    "wheelset CODE KEY > wheelsets.serial, start_ns BIG KEY, track_section CODE NULL > track_sections.code, "
    "content_digest CODE, with_sums FLAG, packed BLOB",
    indexes("track_section start_ns"),
)
table(
    "section_adhesion",
    "track_section CODE KEY > track_sections.code, to_ns BIG KEY, from_ns BIG, code_version TEXT, made_with CODE, "
    "packed BLOB",
    checks(from_before_to="from_ns <= to_ns"),
)
table(
    "alerts",
    "alert_id SERIAL KEY, fleet CODE > fleets.code, wheelset CODE NULL > wheelsets.serial, kind S32, severity S16, "
    "condition S16, opened_ns BIG, last_seen_ns BIG, occurrence_count BIG, probability REAL NULL, evidence JSON, "
    "action TEXT, raise_limit REAL NULL, clear_limit REAL NULL, cleared_ns BIG NULL, closed_ns BIG NULL, "
    "close_reason TEXT NULL, close_code CODE NULL, acknowledged_by TEXT NULL, acknowledged_ns BIG NULL, "
    "shelved_until_ns BIG NULL, shelved_reason TEXT NULL, external_refs JSON, "
    "fleet_alert_id BIG NULL > alerts.alert_id, rules_version TEXT NULL, track_section CODE NULL, version INTEGER",
    checks(
        kind_named="kind <> ''",
        members_have_wheelset="wheelset IS NOT NULL OR fleet_alert_id IS NULL",
        occurrences_counted="occurrence_count > 0",
        version_positive="version > 0",
    ),
    known("condition", "pending active cleared unknown"),
    known("severity", "info warning critical"),
    indexes("fleet_alert_id", "severity alert_id", "wheelset"),
    part("uq_alerts_one_open", "fleet wheelset kind", "closed_ns IS NULL", unique=True),
    part(
        "uq_alerts_one_open_of_fleet",
        "fleet kind",
        "wheelset IS NULL AND track_section IS NULL AND closed_ns IS NULL",
        unique=True,
    ),
    part(
        "uq_alerts_one_open_of_section",
        "fleet track_section kind",
        "track_section IS NOT NULL AND closed_ns IS NULL",
        unique=True,
    ),
    numbered=True,
)
table(
    "alert_events",
    "sequence SERIAL KEY, alert_id BIG > alerts.alert_id, kind S16, alert JSON, recorded_ns BIG, actor TEXT, "
    "note TEXT, in_feed FLAG",
    known("kind", "raised updated acknowledged shelved unshelved cleared closed"),
    indexes("alert_id"),
    numbered=True,
)
table(
    "window_bin_tables",
    "wheelset CODE KEY, start_ns BIG KEY, track_version INTEGER NULL, window_digest CODE, parameter_key S128, "
    "samples BIG, content_digest CODE NULL, running_km REAL NULL, packed BLOB",
    sa.ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
)
table(
    "window_due",
    "stage S32 KEY, wheelset CODE KEY, start_ns BIG KEY, vehicle CODE, section CODE, version BIG",
    indexes("stage section start_ns", "stage vehicle start_ns"),
)
table(
    "wheelset_bins",
    "wheelset CODE KEY > wheelsets.serial, bin INTEGER KEY, geometry_id BIG > results.result_id, "
    "lateral_displacement_low_m REAL, lateral_displacement_high_m REAL, samples REAL NULL, "
    "rolling_radius_sum_m REAL NULL, rolling_radius_sum_std_m REAL NULL, rolling_radius_sum_status S40, "
    "rolling_radius_difference_m REAL NULL, rolling_radius_difference_std_m REAL NULL, "
    "rolling_radius_difference_status S40, contact_angle_sum_rad REAL NULL, contact_angle_sum_std_rad REAL NULL, "
    "contact_angle_sum_status S40, contact_angle_difference_rad REAL NULL, "
    "contact_angle_difference_std_rad REAL NULL, contact_angle_difference_status S40",
    known(
        " ".join(f"{quantity}_status" for quantity in BIN_QUANTITIES),
        "estimated too_few_samples contact_jump unobservable",
    ),
)
table(
    "chunks",
    "digest CODE KEY, vehicle CODE, suffix S16, size_bytes BIG, state S16, reason TEXT, reason_code CODE NULL, "
    "first_ns BIG NULL, last_ns BIG NULL, frames BIG, counts JSON, received_ns BIG, recorded_ns BIG, "
    "purged_ns BIG NULL, clock_checked_ns BIG NULL, file_name TEXT NULL, sender TEXT NULL, "
    "recorder_first_ns BIG NULL, recorder_last_ns BIG NULL",
    checks(
        both_ends_or_none="(first_ns IS NULL) = (last_ns IS NULL)",
        ends_after_start="last_ns >= first_ns",
        size_counted="size_bytes >= 0",
    ),
    known("state", "stored decoded rejected set_aside deleted"),
    indexes("received_ns digest", "state recorded_ns"),
    *chunks_by_length("first_ns", "last_ns"),
    *chunks_by_length("recorder_first_ns", "recorder_last_ns"),
    part("ix_chunks_undecoded", "recorded_ns digest size_bytes", "reason_code = 'waits_for_decoding'"),
)
table(
    "window_dampers",
    "vehicle CODE KEY > vehicles.code, first_axle INTEGER KEY, start_ns BIG KEY, wheelset CODE > wheelsets.serial, "
    "content_digest CODE, packed BLOB",
    checks(first_axle_positive="first_axle > 0"),
)
feed_branches = table(
    "feed_branches", "branch_id SERIAL KEY, identity S32 UNIQUE, after_sequence BIG, began_ns BIG", numbered=True
)
table("fleets", "code CODE KEY, name TEXT")
table("idempotency_keys", "key S255 KEY, request_digest CODE, status_code INTEGER, body TEXT, recorded_ns BIG")
table(
    "job_runs",
    "run_id SERIAL KEY, job CODE, trigger S16, started_ns BIG, finished_ns BIG NULL, outcome S16, counts JSON, "
    "error TEXT NULL, owner BIG NULL",
    checks(running_until_finished="(outcome = 'running') = (finished_ns IS NULL)"),
    known("outcome", "running succeeded failed abandoned"),
    indexes("job run_id"),
    numbered=True,
)
table(
    "measured_profiles",
    "wheelset CODE KEY > wheelsets.serial, at_ns BIG KEY, mileage_km REAL, std_m REAL, packed BLOB",
    checks(std_positive="std_m > 0"),
)
table(
    "mountings",
    "wheelset CODE KEY > wheelsets.serial, from_ns BIG KEY, to_ns BIG NULL, vehicle CODE > vehicles.code, "
    "axle INTEGER, vehicle_odometer_km REAL, wheelset_mileage_km REAL, reversed FLAG",
    checks(axle_positive="axle > 0", ends_after_start="to_ns IS NULL OR to_ns > from_ns"),
    sa.UniqueConstraint("vehicle", "axle", "from_ns"),
)
table(
    "purges",
    "purge_id SERIAL KEY, kind S32, before_ns BIG, items BIG, item_bytes BIG, purged_ns BIG",
    checks(items_counted="items >= 0"),
    indexes("kind before_ns"),
    numbered=True,
)
table(
    "quarantine",
    "kind S16 KEY, key S128 KEY, stage CODE KEY, code CODE, error TEXT, inputs TEXT, first_ns BIG, last_ns BIG, "
    "due_ns BIG, attempts BIG, state S16",
    checks(tried="attempts >= 1"),
    known("kind", "recording window wheelset section vehicle fleet"),
    known("state", "held resolved"),
    indexes("stage state", "state last_ns"),
)
table(
    "recording_changes",
    "id SERIAL KEY, digest CODE, action S16, recorded_ns BIG, actor TEXT, why TEXT, vehicle_before CODE, "
    "state_before S16, vehicle_after CODE, state_after S16",
    known("action", "retry set_aside restore reassign delete take_again"),
    known("state_after state_before", "stored decoded rejected set_aside deleted"),
    indexes("digest id"),
    numbered=True,
)
table("raw_marks", "mark CODE KEY, recorded_ns BIG")
table(
    "rail_cells",
    "wheelset CODE KEY > wheelsets.serial, baseline INTEGER KEY, mileage_interval INTEGER KEY, "
    "section CODE KEY > track_sections.code, period INTEGER KEY, digest CODE, interval_digest CODE, document JSON",
    checks(baseline_counted="baseline >= 0", period_counted="period >= 0"),
)
table(
    "raw_scrubs",
    "scrub_id SERIAL KEY, started_ns BIG, finished_ns BIG NULL, after_digest CODE, files BIG, file_bytes BIG, "
    "faults BIG",
)
table(
    "registry_events",
    "id SERIAL KEY, kind S16, subject CODE, at_ns BIG NULL, action S16, actor TEXT, reason TEXT, record JSON, "
    "recorded_ns BIG NULL, after JSON NULL",
    known("action", "entered changed voided restored"),
    known("kind", "mounting reprofiling measurement wheelset section vehicle vehicle_class sensor_change"),
    indexes("subject kind"),
    numbered=True,
)
table(
    "roll_ups",
    "number SERIAL KEY, wheelset CODE > wheelsets.serial, baseline INTEGER, baseline_interval INTEGER, side INTEGER, "
    "table_key S128, vehicle_class CODE, windows BIG, content CODE, first_ns BIG, last_ns BIG, "
    "sealed FLAG DEFAULT false, summary JSON, plain BLOB, forgetting BLOB NULL",
    checks(windows_counted="windows >= 0"),
    sa.UniqueConstraint(
        "wheelset", "baseline", "baseline_interval", "side", "table_key", "vehicle_class", name="uq_roll_ups_key"
    ),
)
table(
    "roll_up_states",
    "wheelset CODE KEY > wheelsets.serial, rules CODE, classes JSON, earlier_digest CODE NULL, earlier BLOB NULL",
)
table(
    "rolling_sums",
    "wheelset CODE KEY > wheelsets.serial, start_ns BIG KEY, window_digest CODE, assumed S192, packed BLOB",
)
table("stage_marks", "stage S32 KEY, subject CODE KEY, seen BIG, common CODE, made_from CODE, again_ns BIG NULL")
table("subject_versions", "kind S16 KEY, subject CODE KEY, facet S32 KEY, version BIG")
table(
    "sensor_changes",
    "vehicle CODE KEY > vehicles.code, axle INTEGER KEY, at_ns BIG KEY, work S16, removed TEXT, fitted TEXT, note TEXT",
    checks(axle_positive="axle > 0"),
    known("work", "swap calibration"),
)
table("stored_settings", "name CODE KEY, value TEXT, recorded_ns BIG")
table(
    "wear_signatures",
    "wheelset CODE KEY > wheelsets.serial, start_ns BIG KEY, vehicle CODE > vehicles.code, "
    "section CODE NULL > track_sections.code, speed_band_m_s INTEGER NULL, window_digest CODE, assumed CODE, "
    "places BIG, reason TEXT, reason_code CODE NULL, packed BLOB",
    checks(places_counted="places >= 0"),
)
table(
    "stale_spans",
    "id SERIAL KEY, vehicle CODE, from_ns BIG, to_ns BIG, cause TEXT",
    checks(ends_after_start="to_ns > from_ns"),
    indexes("vehicle from_ns"),
    numbered=True,
)
table(
    "suspension_findings",
    "vehicle CODE KEY > vehicles.code, section CODE KEY > track_sections.code, to_ns BIG KEY, from_ns BIG, "
    "ratio REAL, ratio_std REAL, assumed_m REAL, code_version TEXT, epoch INTEGER NULL, recorded_ns BIG",
    checks(
        assumed_positive="assumed_m > 0",
        from_before_to="from_ns <= to_ns",
        ratio_positive="ratio > 0",
        ratio_std_positive="ratio_std > 0",
    ),
)
table(
    "track_epochs",
    "section CODE KEY > track_sections.code, number INTEGER KEY, before TEXT, input_digest CODE, horizon_ns BIG, "
    "windows BIG, waits FLAG, stale FLAG, version INTEGER NULL, same_since INTEGER NULL, estimated_on INTEGER NULL, "
    "survey TEXT, survey_code CODE NULL, report BIG, recorded_ns BIG",
    checks(number_positive="number > 0"),
)
table(
    "track_epoch_windows",
    "wheelset CODE KEY, start_ns BIG KEY, section CODE, epoch INTEGER, vehicle CODE, content_digest CODE, "
    "mileage_km REAL, context CODE, assumed CODE, estimated_version INTEGER NULL",
    indexes("section epoch"),
    sa.ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
)
table(
    "track_epoch_vehicles",
    "section CODE KEY, vehicle CODE KEY, epoch INTEGER KEY, version INTEGER, stiffness_ratio REAL",
    sa.ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
)
table(
    "track_sections",
    "code CODE KEY, number INTEGER UNIQUE, name TEXT, rail_profile TEXT, rail_inclination REAL, nominal_gauge_m REAL, "
    "length_m REAL, line JSON NULL, tonnage_mgt_per_year REAL NULL",
    checks(length_positive="length_m > 0"),
)
table(
    "track_alignments",
    "section CODE KEY > track_sections.code, version INTEGER KEY, status S16, points BIG, content_digest CODE, "
    "packed BLOB",
    checks(version_positive="version > 0"),
    known("status", "unestimated estimated invalid model_mismatch"),
)
table(
    "track_versions",
    "section CODE KEY, version INTEGER KEY, source S16, same_since INTEGER, cut_off_m REAL NULL, scale_std REAL, "
    "gauge_known FLAG, alignment_std_m REAL NULL, recorded_ns BIG, superseded_ns BIG NULL",
    checks(same_since_before="same_since <= version"),
    known("source", "recorded fleet"),
    sa.ForeignKeyConstraint(["section", "version"], ["track_alignments.section", "track_alignments.version"]),
)
table(
    "track_reports",
    "report_id SERIAL KEY, section CODE > track_sections.code, version INTEGER NULL, made FLAG, status S16, "
    "reason TEXT, reason_code CODE NULL, windows BIG, input_digest CODE, code_version TEXT, report JSON, "
    "recorded_ns BIG",
    known("status", "unestimated estimated invalid model_mismatch"),
    indexes("section report_id"),
    numbered=True,
)
table(
    "window_positions",
    "wheelset CODE KEY, start_ns BIG KEY, content_digest CODE, version INTEGER NULL, offset_m REAL, scale REAL, "
    "middle_m REAL, reason TEXT, reason_code CODE NULL",
    sa.ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
)
table(
    "track_layouts",
    "section CODE KEY > track_sections.code, version INTEGER KEY, points BIG, content_digest CODE, packed BLOB",
    checks(version_positive="version > 0"),
)
table(
    "results",
    "result_id SERIAL KEY, stage S32, kind S16, subject CODE, part CODE, made_from CODE, numerics TEXT, status S16, "
    "reason TEXT, reason_code CODE NULL, head TEXT NULL, value BLOB NULL, parameters JSON, recorded_ns BIG, "
    "superseded_ns BIG NULL",
    known("status", "unestimated estimated invalid model_mismatch"),
    indexes("recorded_ns", "superseded_ns"),
    part("ix_results_put_last", "stage subject result_id", "superseded_ns IS NULL"),
    part("ix_results_in_force", "stage subject part", "superseded_ns IS NULL", unique=True),
    part("ix_results_superseded", "stage subject part recorded_ns result_id", "superseded_ns IS NOT NULL"),
    numbered=True,
)
table(
    "vehicle_classes",
    "code CODE KEY, version INTEGER KEY, document JSON, recorded_ns BIG",
    checks(version_counted="version > 0"),
)
table(
    "vehicles",
    "code CODE KEY, fleet CODE > fleets.code, vehicle_class TEXT, axles INTEGER, max_speed_m_s REAL, "
    "axle_offsets_m JSON",
    checks(axles_positive="axles > 0"),
    indexes("fleet"),
)
table(
    "webhooks",
    "webhook_id SERIAL KEY, url TEXT, description TEXT, fleets JSON, kinds JSON, severities JSON, state S16, "
    "disabled_reason S32 NULL, since_ns BIG, created_ns BIG, created_by TEXT, position BIG, revision BIG, "
    "delivered BIG, failed BIG",
    checks(disabled_with_reason="(state = 'disabled') = (disabled_reason IS NOT NULL)"),
    known("disabled_reason", "gone failing"),
    known("state", "active paused disabled"),
    numbered=True,
)
table("webhook_fleets", "webhook_id SERIAL KEY > webhooks.webhook_id, fleet CODE KEY")
table(
    "webhook_secrets",
    "secret_id SERIAL KEY, webhook_id SERIAL > webhooks.webhook_id, secret TEXT, created_ns BIG, until_ns BIG NULL",
    indexes("webhook_id"),
    numbered=True,
)
table(
    "webhook_deliveries",
    "delivery_id SERIAL KEY, webhook_id SERIAL > webhooks.webhook_id, sequence BIG, event_id TEXT, event_kind S32, "
    "alert_id BIG, event_ns BIG, state S16, attempts BIG, first_ns BIG, last_ns BIG, next_ns BIG NULL, "
    "status_code INTEGER NULL, failure S32 NULL, detail TEXT NULL",
    checks(waiting_for_a_time="(state = 'waiting') = (next_ns IS NOT NULL)"),
    known("state", "waiting delivered failed withdrawn"),
    indexes("state last_ns", "webhook_id delivery_id"),
    numbered=True,
)
table(
    "wheelsets",
    "serial CODE KEY, fleet CODE > fleets.code, wheel_profile TEXT, nominal_radius_m REAL",
    checks(radius_positive="nominal_radius_m > 0"),
    indexes("fleet"),
)
table("reprofilings", "wheelset CODE KEY > wheelsets.serial, at_ns BIG KEY, mileage_km REAL, note TEXT")
table(
    "windows",
    "wheelset CODE KEY > wheelsets.serial, start_ns BIG KEY, length_ns BIG, vehicle CODE > vehicles.code, "
    "axle INTEGER, track_section CODE NULL > track_sections.code, mileage_km REAL, coverage REAL NULL, "
    "longest_gap_s REAL NULL, gaps BIG, clipped REAL NULL, invalid REAL NULL, speed_min_m_s REAL NULL, "
    "speed_max_m_s REAL NULL, position_quality REAL NULL, sensor_fault FLAG, hunting_share REAL NULL, "
    "hunting_hz REAL NULL, hunting_amplitude_m REAL NULL, blows_share REAL NULL, blows_m_s2 REAL NULL, "
    "blows_turn_m REAL NULL, blows_side INTEGER NULL, state S16, reason TEXT, reason_code CODE NULL, "
    "content_digest CODE, sample_bytes BIG, recorded_ns BIG, odometer_excess_m REAL DEFAULT 0, "
    "off_line_m REAL DEFAULT 0, implausible TEXT NULL, implausible_code CODE NULL, samples_purged_ns BIG NULL, "
    "table_purged_ns BIG NULL, passed_over S16 NULL",
    checks(length_positive="length_ns > 0"),
    known("state", "pending estimated refused"),
    indexes("track_section start_ns", "vehicle start_ns"),
    part("ix_windows_implausible", "wheelset start_ns", "implausible_code IS NOT NULL"),
    part("ix_windows_passed_over", "wheelset start_ns", "passed_over IS NOT NULL"),
    part("ix_windows_pending", "wheelset start_ns", "state = 'pending'"),
    part("ix_windows_refused", "wheelset reason_code", "reason_code IS NOT NULL"),
    part("ix_windows_with_samples", "start_ns", "samples_purged_ns IS NULL"),
)
table(
    "work_leases",
    "lease_id SERIAL KEY, holder TEXT, owner BIG NULL > work_leases.lease_id DELETE CASCADE, unit S32 NULL, "
    "length_ns BIG, until_ns BIG",
    checks(length_positive="length_ns > 0"),
    indexes("until_ns"),
    numbered=True,
)
table(
    "work_claims",
    "stage CODE KEY, key S128 KEY, lease_id BIG NULL > work_leases.lease_id DELETE NULLED, attempts BIG, begun_ns BIG",
    checks(begun="attempts >= 1"),
    indexes("lease_id"),
)
table(
    "worklist_entries",
    "wheelset CODE KEY > wheelsets.serial, fleet CODE, vehicle CODE NULL, vehicle_class TEXT NULL, status S16, "
    "urgency S16, worst_severity S16 NULL, urgency_key REAL, distance_key REAL NULL, conicity_key REAL NULL, "
    "trend_key REAL NULL, mileage_key REAL NULL, last_data_ns BIG NULL, document TEXT",
    known("status", "unestimated estimated invalid model_mismatch"),
    known("urgency", "over_limit probably_over critical_alert due watch unknown fine not_mounted"),
    known("worst_severity", "info warning critical"),
    indexes(
        "conicity_key wheelset",
        "distance_key wheelset",
        "fleet conicity_key wheelset",
        "fleet distance_key wheelset",
        "fleet last_data_ns wheelset",
        "fleet mileage_key wheelset",
        "fleet trend_key wheelset",
        "fleet urgency_key wheelset",
        "fleet wheelset",
        "last_data_ns wheelset",
        "mileage_key wheelset",
        "status wheelset",
        "trend_key wheelset",
        "urgency_key wheelset",
        "urgency wheelset",
        "vehicle_class wheelset",
        "vehicle wheelset",
        "worst_severity wheelset",
    ),
)
table(
    "worklist_alerts", "kind S32 KEY, wheelset CODE KEY > worklist_entries.wheelset DELETE CASCADE", indexes("wheelset")
)
