"""All tables of the first release."""

from __future__ import annotations

import time
import uuid
from typing import Any

import sqlalchemy as sa
from alembic import op

from fleet_db.tables.base import NAMING, one_of

revision: str = "r0001"
down_revision: str | None = None
branch_labels: str | None = None
depends_on: str | None = None

TABLES = sa.MetaData(naming_convention=NAMING)
types: dict[str, sa.types.TypeEngine[Any]] = {
    # SQLite numbers rows by itself only in a column declared INTEGER, which there is 64 bits wide as well
    "serial": sa.BigInteger().with_variant(sa.Integer(), "sqlite"),
    "integer": sa.Integer(),
    "big": sa.BigInteger(),
    "flag": sa.Boolean(),
    "real": sa.Double(),
    "code": sa.String(64),
    "text": sa.Text(),
    "json": sa.JSON(),
    "blob": sa.LargeBinary(),
    **{f"s{length}": sa.String(length) for length in (8, 16, 32, 40, 128, 192, 255)},
}
BIN_QUANTITIES = ("rolling_radius_sum", "rolling_radius_difference", "contact_angle_sum", "contact_angle_difference")
Items = list[sa.schema.SchemaItem]


def upgrade() -> None:
    TABLES.create_all(op.get_bind(), checkfirst=False)
    # the identity of this database: until its first restore all events of its feed are of this branch
    branch = {"identity": uuid.uuid4().hex, "after_sequence": 0, "began_ns": time.time_ns()}
    op.bulk_insert(feed_branches, [branch])


def table(name: str, *parts: Items | sa.schema.SchemaItem, numbered: bool = False) -> sa.Table:
    """Add a table; ``numbered``: SQLite uses no number of a row twice."""
    items = [item for part in parts for item in (part if isinstance(part, list) else [part])]
    return sa.Table(name, TABLES, *items, sqlite_autoincrement=numbered)


def columns(names_by_type: dict[str, str], *, nullable: bool = True, primary_key: bool = False) -> Items:
    """Return columns; ``wheelset>wheelsets.serial`` refers to that column."""
    items: Items = []
    for kind, names in names_by_type.items():
        for name, _, target in (name.partition(">") for name in names.split()):
            to = [sa.ForeignKey(target)] if target else []
            items.append(sa.Column(name, types[kind], *to, nullable=nullable, primary_key=primary_key))
    return items


def key(**names_by_type: str) -> Items:
    return columns(names_by_type, nullable=False, primary_key=True)


def required(**names_by_type: str) -> Items:
    return columns(names_by_type, nullable=False)


def optional(**names_by_type: str) -> Items:
    return columns(names_by_type)


def checks(**conditions: str) -> Items:
    return [sa.CheckConstraint(condition, name=name) for name, condition in conditions.items()]


def known(names: str, values: str) -> Items:
    return [one_of(name, values.split()) for name in names.split()]


def indexes(*names: str) -> Items:
    return [sa.Index(None, *columns.split()) for columns in names]


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
    key(s8="prefix"),
    required(code="digest", text="owner created_by", json="scopes", big="created_ns"),
    optional(json="fleets", big="expires_ns revoked_ns last_used_ns"),
)
table(
    "audit_entries",
    key(serial="entry_id"),
    required(big="at_ns", s16="method", text="path", integer="status"),
    optional(text="owner object address", code="key_prefix request_id"),
    indexes("at_ns", "key_prefix entry_id"),
    numbered=True,
)
table(
    "window_adhesion",
    key(code="wheelset>wheelsets.serial", big="start_ns"),
    required(code="content_digest", flag="with_sums", blob="packed"),
    optional(code="track_section>track_sections.code"),
    indexes("track_section start_ns"),
)
table(
    "section_adhesion",
    key(code="track_section>track_sections.code", big="to_ns"),
    required(big="from_ns", text="code_version", code="made_with", blob="packed"),
    checks(from_before_to="from_ns <= to_ns"),
)
table(
    "alerts",
    key(serial="alert_id"),
    required(
        code="fleet>fleets.code",
        s32="kind",
        s16="severity condition",
        big="opened_ns last_seen_ns occurrence_count",
        json="evidence external_refs",
        text="action",
        integer="version",
    ),
    optional(
        code="wheelset>wheelsets.serial close_code track_section",
        real="probability raise_limit clear_limit",
        big="cleared_ns closed_ns acknowledged_ns shelved_until_ns fleet_alert_id>alerts.alert_id",
        text="close_reason acknowledged_by shelved_reason rules_version",
    ),
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
    key(serial="sequence"),
    required(big="alert_id>alerts.alert_id recorded_ns", s16="kind", json="alert", text="actor note", flag="in_feed"),
    known("kind", "raised updated acknowledged shelved unshelved cleared closed"),
    indexes("alert_id"),
    numbered=True,
)
table(
    "window_bin_tables",
    key(code="wheelset", big="start_ns"),
    required(code="window_digest", s128="parameter_key", big="samples", blob="packed"),
    optional(integer="track_version", code="content_digest", real="running_km"),
    sa.ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
)
table(
    "window_due",
    key(s32="stage", code="wheelset", big="start_ns"),
    required(code="vehicle section", big="version"),
    indexes("stage section start_ns", "stage vehicle start_ns"),
)
table(
    "wheelset_bins",
    key(code="wheelset>wheelsets.serial", integer="bin"),
    required(
        big="geometry_id>results.result_id",
        real="lateral_displacement_low_m lateral_displacement_high_m",
        s40=" ".join(f"{quantity}_status" for quantity in BIN_QUANTITIES),
    ),
    optional(
        real="samples rolling_radius_sum_m rolling_radius_sum_std_m rolling_radius_difference_m "
        "rolling_radius_difference_std_m contact_angle_sum_rad contact_angle_sum_std_rad contact_angle_difference_rad "
        "contact_angle_difference_std_rad"
    ),
    known(
        " ".join(f"{quantity}_status" for quantity in BIN_QUANTITIES),
        "estimated too_few_samples contact_jump unobservable",
    ),
)
table(
    "chunks",
    key(code="digest"),
    required(
        code="vehicle",
        s16="suffix state",
        big="size_bytes frames received_ns recorded_ns",
        text="reason",
        json="counts",
    ),
    optional(
        code="reason_code",
        big="first_ns last_ns purged_ns clock_checked_ns recorder_first_ns recorder_last_ns",
        text="file_name sender",
    ),
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
    key(code="vehicle>vehicles.code", integer="first_axle", big="start_ns"),
    required(code="wheelset>wheelsets.serial content_digest", blob="packed"),
    checks(first_axle_positive="first_axle > 0"),
)
feed_branches = table(
    "feed_branches",
    key(serial="branch_id"),
    required(big="after_sequence began_ns"),
    sa.Column("identity", types["s32"], unique=True, nullable=False),
    numbered=True,
)
table("fleets", key(code="code"), required(text="name"))
table(
    "idempotency_keys",
    key(s255="key"),
    required(code="request_digest", integer="status_code", text="body", big="recorded_ns"),
)
table(
    "job_runs",
    key(serial="run_id"),
    required(code="job", s16="trigger outcome", big="started_ns", json="counts"),
    optional(big="finished_ns owner", text="error"),
    checks(running_until_finished="(outcome = 'running') = (finished_ns IS NULL)"),
    known("outcome", "running succeeded failed abandoned"),
    indexes("job run_id"),
    numbered=True,
)
table(
    "measured_profiles",
    key(code="wheelset>wheelsets.serial", big="at_ns"),
    required(real="mileage_km std_m", blob="packed"),
    checks(std_positive="std_m > 0"),
)
table(
    "mountings",
    key(code="wheelset>wheelsets.serial", big="from_ns"),
    required(
        code="vehicle>vehicles.code", integer="axle", real="vehicle_odometer_km wheelset_mileage_km", flag="reversed"
    ),
    optional(big="to_ns"),
    checks(axle_positive="axle > 0", ends_after_start="to_ns IS NULL OR to_ns > from_ns"),
    sa.UniqueConstraint("vehicle", "axle", "from_ns"),
)
table(
    "purges",
    key(serial="purge_id"),
    required(s32="kind", big="before_ns items item_bytes purged_ns"),
    checks(items_counted="items >= 0"),
    indexes("kind before_ns"),
    numbered=True,
)
table(
    "quarantine",
    key(s16="kind", s128="key", code="stage"),
    required(code="code", text="error inputs", big="first_ns last_ns due_ns attempts", s16="state"),
    checks(tried="attempts >= 1"),
    known("kind", "recording window wheelset section vehicle fleet"),
    known("state", "held resolved"),
    indexes("stage state", "state last_ns"),
)
table(
    "recording_changes",
    key(serial="id"),
    required(
        code="digest vehicle_before vehicle_after",
        s16="action state_before state_after",
        big="recorded_ns",
        text="actor why",
    ),
    known("action", "retry set_aside restore reassign delete take_again"),
    known("state_after state_before", "stored decoded rejected set_aside deleted"),
    indexes("digest id"),
    numbered=True,
)
table("raw_marks", key(code="mark"), required(big="recorded_ns"))
table(
    "rail_cells",
    key(code="wheelset>wheelsets.serial", integer="baseline mileage_interval"),
    key(code="section>track_sections.code", integer="period"),
    required(code="digest interval_digest", json="document"),
    checks(baseline_counted="baseline >= 0", period_counted="period >= 0"),
)
table(
    "raw_scrubs",
    key(serial="scrub_id"),
    required(big="started_ns files file_bytes faults", code="after_digest"),
    optional(big="finished_ns"),
)
table(
    "registry_events",
    key(serial="id"),
    required(s16="kind action", code="subject", text="actor reason", json="record"),
    optional(big="at_ns recorded_ns", json="after"),
    known("action", "entered changed voided restored"),
    known("kind", "mounting reprofiling measurement wheelset section vehicle vehicle_class sensor_change"),
    indexes("subject kind"),
    numbered=True,
)
table(
    "roll_ups",
    key(serial="number"),
    required(
        code="wheelset>wheelsets.serial vehicle_class content",
        integer="baseline baseline_interval side",
        s128="table_key",
        big="windows first_ns last_ns",
        json="summary",
        blob="plain",
    ),
    optional(blob="forgetting"),
    sa.Column("sealed", types["flag"], server_default=sa.false(), nullable=False),
    checks(windows_counted="windows >= 0"),
    sa.UniqueConstraint(
        "wheelset", "baseline", "baseline_interval", "side", "table_key", "vehicle_class", name="uq_roll_ups_key"
    ),
)
table(
    "roll_up_states",
    key(code="wheelset>wheelsets.serial"),
    required(code="rules", json="classes"),
    optional(code="earlier_digest", blob="earlier"),
)
table(
    "rolling_sums",
    key(code="wheelset>wheelsets.serial", big="start_ns"),
    required(code="window_digest", s192="assumed", blob="packed"),
)
table(
    "stage_marks",
    key(s32="stage", code="subject"),
    required(big="seen", code="common made_from"),
    optional(big="again_ns"),
)
table("subject_versions", key(s16="kind", code="subject", s32="facet"), required(big="version"))
table(
    "sensor_changes",
    key(code="vehicle>vehicles.code", integer="axle", big="at_ns"),
    required(s16="work", text="removed fitted note"),
    checks(axle_positive="axle > 0"),
    known("work", "swap calibration"),
)
table("stored_settings", key(code="name"), required(text="value", big="recorded_ns"))
table(
    "wear_signatures",
    key(code="wheelset>wheelsets.serial", big="start_ns"),
    required(code="vehicle>vehicles.code window_digest assumed", big="places", text="reason", blob="packed"),
    optional(code="section>track_sections.code reason_code", integer="speed_band_m_s"),
    checks(places_counted="places >= 0"),
)
table(
    "stale_spans",
    key(serial="id"),
    required(code="vehicle", big="from_ns to_ns", text="cause"),
    checks(ends_after_start="to_ns > from_ns"),
    indexes("vehicle from_ns"),
    numbered=True,
)
table(
    "suspension_findings",
    key(code="vehicle>vehicles.code section>track_sections.code", big="to_ns"),
    required(big="from_ns recorded_ns", real="ratio ratio_std assumed_m", text="code_version"),
    optional(integer="epoch"),
    checks(
        assumed_positive="assumed_m > 0",
        from_before_to="from_ns <= to_ns",
        ratio_positive="ratio > 0",
        ratio_std_positive="ratio_std > 0",
    ),
)
table(
    "track_epochs",
    key(code="section>track_sections.code", integer="number"),
    required(
        text="before survey", code="input_digest", big="horizon_ns windows report recorded_ns", flag="waits stale"
    ),
    optional(integer="version same_since estimated_on", code="survey_code"),
    checks(number_positive="number > 0"),
)
table(
    "track_epoch_windows",
    key(code="wheelset", big="start_ns"),
    required(code="section vehicle content_digest context assumed", integer="epoch", real="mileage_km"),
    optional(integer="estimated_version"),
    indexes("section epoch"),
    sa.ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
)
table(
    "track_epoch_vehicles",
    key(code="section vehicle", integer="epoch"),
    required(integer="version", real="stiffness_ratio"),
    sa.ForeignKeyConstraint(["section", "epoch"], ["track_epochs.section", "track_epochs.number"], ondelete="CASCADE"),
)
table(
    "track_sections",
    key(code="code"),
    required(text="name rail_profile", real="rail_inclination nominal_gauge_m length_m"),
    optional(json="line", real="tonnage_mgt_per_year"),
    sa.Column("number", types["integer"], unique=True, nullable=False),
    checks(length_positive="length_m > 0"),
)
table(
    "track_alignments",
    key(code="section>track_sections.code", integer="version"),
    required(s16="status", big="points", code="content_digest", blob="packed"),
    checks(version_positive="version > 0"),
    known("status", "unestimated estimated invalid model_mismatch"),
)
table(
    "track_versions",
    key(code="section", integer="version"),
    required(s16="source", integer="same_since", real="scale_std", flag="gauge_known", big="recorded_ns"),
    optional(real="cut_off_m alignment_std_m", big="superseded_ns"),
    checks(same_since_before="same_since <= version"),
    known("source", "recorded fleet"),
    sa.ForeignKeyConstraint(["section", "version"], ["track_alignments.section", "track_alignments.version"]),
)
table(
    "track_reports",
    key(serial="report_id"),
    required(
        code="section>track_sections.code input_digest",
        flag="made",
        s16="status",
        text="reason code_version",
        big="windows recorded_ns",
        json="report",
    ),
    optional(integer="version", code="reason_code"),
    known("status", "unestimated estimated invalid model_mismatch"),
    indexes("section report_id"),
    numbered=True,
)
table(
    "window_positions",
    key(code="wheelset", big="start_ns"),
    required(code="content_digest", real="offset_m scale middle_m", text="reason"),
    optional(integer="version", code="reason_code"),
    sa.ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
)
table(
    "track_layouts",
    key(code="section>track_sections.code", integer="version"),
    required(big="points", code="content_digest", blob="packed"),
    checks(version_positive="version > 0"),
)
table(
    "results",
    key(serial="result_id"),
    required(
        s32="stage",
        s16="kind status",
        code="subject part made_from",
        text="numerics reason",
        json="parameters",
        big="recorded_ns",
    ),
    optional(code="reason_code", text="head", blob="value", big="superseded_ns"),
    known("status", "unestimated estimated invalid model_mismatch"),
    indexes("recorded_ns", "superseded_ns"),
    part("ix_results_put_last", "stage subject result_id", "superseded_ns IS NULL"),
    part("ix_results_in_force", "stage subject part", "superseded_ns IS NULL", unique=True),
    part("ix_results_superseded", "stage subject part recorded_ns result_id", "superseded_ns IS NOT NULL"),
    numbered=True,
)
table(
    "vehicle_classes",
    key(code="code", integer="version"),
    required(json="document", big="recorded_ns"),
    checks(version_counted="version > 0"),
)
table(
    "vehicles",
    key(code="code"),
    required(
        code="fleet>fleets.code", text="vehicle_class", integer="axles", real="max_speed_m_s", json="axle_offsets_m"
    ),
    checks(axles_positive="axles > 0"),
    indexes("fleet"),
)
table(
    "webhooks",
    key(serial="webhook_id"),
    required(
        text="url description created_by",
        json="fleets kinds severities",
        s16="state",
        big="since_ns created_ns position revision delivered failed",
    ),
    optional(s32="disabled_reason"),
    checks(disabled_with_reason="(state = 'disabled') = (disabled_reason IS NOT NULL)"),
    known("disabled_reason", "gone failing"),
    known("state", "active paused disabled"),
    numbered=True,
)
table("webhook_fleets", key(serial="webhook_id>webhooks.webhook_id", code="fleet"))
table(
    "webhook_secrets",
    key(serial="secret_id"),
    required(serial="webhook_id>webhooks.webhook_id", text="secret", big="created_ns"),
    optional(big="until_ns"),
    indexes("webhook_id"),
    numbered=True,
)
table(
    "webhook_deliveries",
    key(serial="delivery_id"),
    required(
        serial="webhook_id>webhooks.webhook_id",
        big="sequence alert_id event_ns attempts first_ns last_ns",
        text="event_id",
        s32="event_kind",
        s16="state",
    ),
    optional(big="next_ns", integer="status_code", s32="failure", text="detail"),
    checks(waiting_for_a_time="(state = 'waiting') = (next_ns IS NOT NULL)"),
    known("state", "waiting delivered failed withdrawn"),
    indexes("state last_ns", "webhook_id delivery_id"),
    numbered=True,
)
table(
    "wheelsets",
    key(code="serial"),
    required(code="fleet>fleets.code", text="wheel_profile", real="nominal_radius_m"),
    checks(radius_positive="nominal_radius_m > 0"),
    indexes("fleet"),
)
table("reprofilings", key(code="wheelset>wheelsets.serial", big="at_ns"), required(real="mileage_km", text="note"))
table(
    "windows",
    key(code="wheelset>wheelsets.serial", big="start_ns"),
    required(
        big="length_ns gaps sample_bytes recorded_ns",
        code="vehicle>vehicles.code content_digest",
        integer="axle",
        real="mileage_km",
        flag="sensor_fault",
        s16="state",
        text="reason",
    ),
    optional(
        code="track_section>track_sections.code reason_code implausible_code",
        real="coverage longest_gap_s clipped invalid speed_min_m_s speed_max_m_s position_quality "
        "hunting_share hunting_hz hunting_amplitude_m blows_share blows_m_s2 blows_turn_m",
        integer="blows_side",
        text="implausible",
        big="samples_purged_ns table_purged_ns",
        s16="passed_over",
    ),
    sa.Column("odometer_excess_m", types["real"], server_default=sa.text("0"), nullable=False),
    sa.Column("off_line_m", types["real"], server_default=sa.text("0"), nullable=False),
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
    key(serial="lease_id"),
    required(text="holder", big="length_ns until_ns"),
    optional(s32="unit"),
    sa.Column("owner", types["big"], sa.ForeignKey("work_leases.lease_id", ondelete="CASCADE")),
    checks(length_positive="length_ns > 0"),
    indexes("until_ns"),
    numbered=True,
)
table(
    "work_claims",
    key(code="stage", s128="key"),
    required(big="attempts begun_ns"),
    sa.Column("lease_id", types["big"], sa.ForeignKey("work_leases.lease_id", ondelete="SET NULL")),
    checks(begun="attempts >= 1"),
    indexes("lease_id"),
)
table(
    "worklist_entries",
    key(code="wheelset>wheelsets.serial"),
    required(code="fleet", s16="status urgency", real="urgency_key", text="document"),
    optional(
        code="vehicle",
        text="vehicle_class",
        s16="worst_severity",
        real="distance_key conicity_key trend_key mileage_key",
        big="last_data_ns",
    ),
    known("status", "unestimated estimated invalid model_mismatch"),
    known("urgency", "over_limit critical_alert due warning_alert unknown not_due not_mounted"),
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
    "worklist_alerts",
    key(s32="kind"),
    sa.Column(
        "wheelset", types["code"], sa.ForeignKey("worklist_entries.wheelset", ondelete="CASCADE"), primary_key=True
    ),
    indexes("wheelset"),
)
