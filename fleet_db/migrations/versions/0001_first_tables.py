"""The first tables."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision: str = "0001"
down_revision: str | None = None
branch_labels: str | None = None
depends_on: str | None = None


TABLES = (
    "chunks",
    "fleets",
    "idempotency_keys",
    "job_runs",
    "track_sections",
    "track_alignments",
    "vehicles",
    "wheelsets",
    "alerts",
    "geometry_estimates",
    "mountings",
    "reprofilings",
    "trends",
    "wheelset_changes",
    "windows",
    "alert_events",
    "wheelset_bins",
    "window_bin_tables",
)


def upgrade() -> None:
    _chunks()
    _fleets()
    _idempotency_keys()
    _job_runs()
    _track_sections()
    _track_alignments()
    _vehicles()
    _wheelsets()
    _alerts()
    _geometry_estimates()
    _mountings()
    _reprofilings()
    _trends()
    _wheelset_changes()
    _windows()
    _alert_events()
    _wheelset_bins()
    _window_bin_tables()


def downgrade() -> None:
    for name in reversed(TABLES):
        op.drop_table(name)


def _chunks() -> None:
    op.create_table(
        "chunks",
        sa.Column("digest", sa.String(length=64), nullable=False),
        sa.Column("vehicle", sa.String(length=64), nullable=False),
        sa.Column("suffix", sa.String(length=16), nullable=False),
        sa.Column("size_bytes", sa.BigInteger(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("first_ns", sa.BigInteger(), nullable=True),
        sa.Column("last_ns", sa.BigInteger(), nullable=True),
        sa.Column("frames", sa.BigInteger(), nullable=False),
        sa.Column("counts", sa.JSON(), nullable=False),
        sa.Column("received_ns", sa.BigInteger(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("state IN ('stored', 'decoded', 'rejected')", name=op.f("ck_chunks_state_known")),
        sa.CheckConstraint("(first_ns IS NULL) = (last_ns IS NULL)", name=op.f("ck_chunks_both_ends_or_none")),
        sa.CheckConstraint("last_ns >= first_ns", name=op.f("ck_chunks_ends_after_start")),
        sa.CheckConstraint("size_bytes >= 0", name=op.f("ck_chunks_size_counted")),
        sa.PrimaryKeyConstraint("digest", name=op.f("pk_chunks")),
    )
    op.create_index(op.f("ix_chunks_state_recorded_ns"), "chunks", ["state", "recorded_ns"], unique=False)
    op.create_index(op.f("ix_chunks_vehicle_first_ns"), "chunks", ["vehicle", "first_ns"], unique=False)


def _fleets() -> None:
    op.create_table(
        "fleets",
        sa.Column("code", sa.String(length=64), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.PrimaryKeyConstraint("code", name=op.f("pk_fleets")),
    )


def _idempotency_keys() -> None:
    op.create_table(
        "idempotency_keys",
        sa.Column("key", sa.String(length=255), nullable=False),
        sa.Column("request_digest", sa.String(length=64), nullable=False),
        sa.Column("status_code", sa.Integer(), nullable=False),
        sa.Column("body", sa.Text(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.PrimaryKeyConstraint("key", name=op.f("pk_idempotency_keys")),
    )


def _job_runs() -> None:
    op.create_table(
        "job_runs",
        sa.Column("run_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("job", sa.String(length=64), nullable=False),
        sa.Column("trigger", sa.String(length=16), nullable=False),
        sa.Column("started_ns", sa.BigInteger(), nullable=False),
        sa.Column("finished_ns", sa.BigInteger(), nullable=True),
        sa.Column("outcome", sa.String(length=16), nullable=False),
        sa.Column("counts", sa.JSON(), nullable=False),
        sa.Column("error", sa.Text(), nullable=True),
        sa.CheckConstraint(
            "(outcome = 'running') = (finished_ns IS NULL)", name=op.f("ck_job_runs_running_until_finished")
        ),
        sa.CheckConstraint(
            "outcome IN ('running', 'succeeded', 'failed', 'abandoned')", name=op.f("ck_job_runs_outcome_known")
        ),
        sa.PrimaryKeyConstraint("run_id", name=op.f("pk_job_runs")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_job_runs_job_run_id"), "job_runs", ["job", "run_id"], unique=False)


def _track_sections() -> None:
    op.create_table(
        "track_sections",
        sa.Column("code", sa.String(length=64), nullable=False),
        sa.Column("number", sa.Integer(), nullable=False),
        sa.Column("name", sa.Text(), nullable=False),
        sa.Column("rail_profile", sa.Text(), nullable=False),
        sa.Column("rail_inclination", sa.Double(), nullable=False),
        sa.Column("nominal_gauge_m", sa.Double(), nullable=False),
        sa.Column("length_m", sa.Double(), nullable=False),
        sa.CheckConstraint("length_m > 0", name=op.f("ck_track_sections_length_positive")),
        sa.PrimaryKeyConstraint("code", name=op.f("pk_track_sections")),
        sa.UniqueConstraint("number", name=op.f("uq_track_sections_number")),
    )


def _track_alignments() -> None:
    op.create_table(
        "track_alignments",
        sa.Column("section", sa.String(length=64), nullable=False),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("points", sa.BigInteger(), nullable=False),
        sa.Column("content_digest", sa.String(length=64), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint(
            "status IN ('unestimated', 'estimated', 'invalid')", name=op.f("ck_track_alignments_status_known")
        ),
        sa.CheckConstraint("version > 0", name=op.f("ck_track_alignments_version_positive")),
        sa.ForeignKeyConstraint(
            ["section"], ["track_sections.code"], name=op.f("fk_track_alignments_section_track_sections")
        ),
        sa.PrimaryKeyConstraint("section", "version", name=op.f("pk_track_alignments")),
    )


def _vehicles() -> None:
    op.create_table(
        "vehicles",
        sa.Column("code", sa.String(length=64), nullable=False),
        sa.Column("fleet", sa.String(length=64), nullable=False),
        sa.Column("vehicle_class", sa.Text(), nullable=False),
        sa.Column("axles", sa.Integer(), nullable=False),
        sa.Column("max_speed_m_s", sa.Double(), nullable=False),
        sa.Column("axle_offsets_m", sa.JSON(), nullable=False),
        sa.CheckConstraint("axles > 0", name=op.f("ck_vehicles_axles_positive")),
        sa.ForeignKeyConstraint(["fleet"], ["fleets.code"], name=op.f("fk_vehicles_fleet_fleets")),
        sa.PrimaryKeyConstraint("code", name=op.f("pk_vehicles")),
    )
    op.create_index(op.f("ix_vehicles_fleet"), "vehicles", ["fleet"], unique=False)


def _wheelsets() -> None:
    op.create_table(
        "wheelsets",
        sa.Column("serial", sa.String(length=64), nullable=False),
        sa.Column("fleet", sa.String(length=64), nullable=False),
        sa.Column("wheel_profile", sa.Text(), nullable=False),
        sa.Column("nominal_radius_m", sa.Double(), nullable=False),
        sa.CheckConstraint("nominal_radius_m > 0", name=op.f("ck_wheelsets_radius_positive")),
        sa.ForeignKeyConstraint(["fleet"], ["fleets.code"], name=op.f("fk_wheelsets_fleet_fleets")),
        sa.PrimaryKeyConstraint("serial", name=op.f("pk_wheelsets")),
    )
    op.create_index(op.f("ix_wheelsets_fleet"), "wheelsets", ["fleet"], unique=False)


def _alerts() -> None:
    op.create_table(
        "alerts",
        sa.Column("alert_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("fleet", sa.String(length=64), nullable=False),
        sa.Column("wheelset", sa.String(length=64), nullable=True),
        sa.Column("kind", sa.String(length=32), nullable=False),
        sa.Column("severity", sa.String(length=16), nullable=False),
        sa.Column("condition", sa.String(length=16), nullable=False),
        sa.Column("opened_ns", sa.BigInteger(), nullable=False),
        sa.Column("last_seen_ns", sa.BigInteger(), nullable=False),
        sa.Column("occurrence_count", sa.BigInteger(), nullable=False),
        sa.Column("probability", sa.Double(), nullable=True),
        sa.Column("evidence", sa.JSON(), nullable=False),
        sa.Column("action", sa.Text(), nullable=False),
        sa.Column("raise_limit", sa.Double(), nullable=True),
        sa.Column("clear_limit", sa.Double(), nullable=True),
        sa.Column("cleared_ns", sa.BigInteger(), nullable=True),
        sa.Column("closed_ns", sa.BigInteger(), nullable=True),
        sa.Column("close_reason", sa.Text(), nullable=True),
        sa.Column("acknowledged_by", sa.Text(), nullable=True),
        sa.Column("acknowledged_ns", sa.BigInteger(), nullable=True),
        sa.Column("shelved_until_ns", sa.BigInteger(), nullable=True),
        sa.Column("shelved_reason", sa.Text(), nullable=True),
        sa.Column("external_refs", sa.JSON(), nullable=False),
        sa.Column("fleet_alert_id", sa.BigInteger(), nullable=True),
        sa.Column("version", sa.Integer(), nullable=False),
        sa.CheckConstraint(
            "condition IN ('pending', 'active', 'cleared', 'unknown')", name=op.f("ck_alerts_condition_known")
        ),
        sa.CheckConstraint(
            "kind IN ('conicity_limit', 'limit_forecast', 'wheel_asymmetry', 'no_data', 'sensor_fault')",
            name=op.f("ck_alerts_kind_known"),
        ),
        sa.CheckConstraint("severity IN ('info', 'warning', 'critical')", name=op.f("ck_alerts_severity_known")),
        sa.CheckConstraint("occurrence_count > 0", name=op.f("ck_alerts_occurrences_counted")),
        sa.CheckConstraint("version > 0", name=op.f("ck_alerts_version_positive")),
        sa.CheckConstraint(
            "wheelset IS NOT NULL OR fleet_alert_id IS NULL", name=op.f("ck_alerts_members_have_wheelset")
        ),
        sa.ForeignKeyConstraint(["fleet"], ["fleets.code"], name=op.f("fk_alerts_fleet_fleets")),
        sa.ForeignKeyConstraint(["fleet_alert_id"], ["alerts.alert_id"], name=op.f("fk_alerts_fleet_alert_id_alerts")),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_alerts_wheelset_wheelsets")),
        sa.PrimaryKeyConstraint("alert_id", name=op.f("pk_alerts")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_alerts_wheelset"), "alerts", ["wheelset"], unique=False)
    op.create_index(op.f("ix_alerts_fleet_alert_id"), "alerts", ["fleet_alert_id"], unique=False)
    op.create_index(
        "uq_alerts_one_open_of_fleet",
        "alerts",
        ["fleet", "kind"],
        unique=True,
        sqlite_where=sa.text("wheelset IS NULL AND closed_ns IS NULL"),
        postgresql_where=sa.text("wheelset IS NULL AND closed_ns IS NULL"),
    )
    op.create_index(
        "uq_alerts_one_open",
        "alerts",
        ["fleet", "wheelset", "kind"],
        unique=True,
        sqlite_where=sa.text("closed_ns IS NULL"),
        postgresql_where=sa.text("closed_ns IS NULL"),
    )


def _geometry_estimates() -> None:
    op.create_table(
        "geometry_estimates",
        sa.Column("geometry_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("baseline", sa.Integer(), nullable=False),
        sa.Column("baseline_interval", sa.Integer(), nullable=True),
        sa.Column("mileage_km", sa.Double(), nullable=True),
        sa.Column("from_ns", sa.BigInteger(), nullable=False),
        sa.Column("to_ns", sa.BigInteger(), nullable=False),
        sa.Column("input_digest", sa.String(length=64), nullable=False),
        sa.Column("track_versions", sa.JSON(), nullable=False),
        sa.Column("parameters", sa.JSON(), nullable=False),
        sa.Column("code_version", sa.Text(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("windows", sa.BigInteger(), nullable=False),
        sa.Column("parameter_key", sa.String(length=128), nullable=False),
        sa.Column("headline_amplitude_m", sa.Double(), nullable=True),
        sa.Column("equivalent_conicity", sa.Double(), nullable=True),
        sa.Column("equivalent_conicity_std", sa.Double(), nullable=True),
        sa.Column("equivalent_conicity_low", sa.Double(), nullable=True),
        sa.Column("equivalent_conicity_high", sa.Double(), nullable=True),
        sa.Column("nonlinearity_per_mm", sa.Double(), nullable=True),
        sa.Column("nonlinearity_std_per_mm", sa.Double(), nullable=True),
        sa.Column("zero_crossing_m", sa.Double(), nullable=True),
        sa.Column("zero_crossing_std_m", sa.Double(), nullable=True),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint(
            "status IN ('unestimated', 'estimated', 'invalid')", name=op.f("ck_geometry_estimates_status_known")
        ),
        sa.CheckConstraint("baseline >= 0", name=op.f("ck_geometry_estimates_baseline_counted")),
        sa.ForeignKeyConstraint(
            ["wheelset"], ["wheelsets.serial"], name=op.f("fk_geometry_estimates_wheelset_wheelsets")
        ),
        sa.PrimaryKeyConstraint("geometry_id", name=op.f("pk_geometry_estimates")),
        sqlite_autoincrement=True,
    )
    op.create_index(
        op.f("ix_geometry_estimates_wheelset_baseline_baseline_interval_recorded_ns"),
        "geometry_estimates",
        ["wheelset", "baseline", "baseline_interval", "recorded_ns"],
        unique=False,
    )


def _mountings() -> None:
    op.create_table(
        "mountings",
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("from_ns", sa.BigInteger(), nullable=False),
        sa.Column("to_ns", sa.BigInteger(), nullable=True),
        sa.Column("vehicle", sa.String(length=64), nullable=False),
        sa.Column("axle", sa.Integer(), nullable=False),
        sa.Column("vehicle_odometer_km", sa.Double(), nullable=False),
        sa.Column("wheelset_mileage_km", sa.Double(), nullable=False),
        sa.Column("reversed", sa.Boolean(), nullable=False),
        sa.CheckConstraint("axle > 0", name=op.f("ck_mountings_axle_positive")),
        sa.CheckConstraint("to_ns IS NULL OR to_ns > from_ns", name=op.f("ck_mountings_ends_after_start")),
        sa.ForeignKeyConstraint(["vehicle"], ["vehicles.code"], name=op.f("fk_mountings_vehicle_vehicles")),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_mountings_wheelset_wheelsets")),
        sa.PrimaryKeyConstraint("wheelset", "from_ns", name=op.f("pk_mountings")),
        sa.UniqueConstraint("vehicle", "axle", "from_ns", name=op.f("uq_mountings_vehicle_axle_from_ns")),
    )


def _reprofilings() -> None:
    op.create_table(
        "reprofilings",
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("at_ns", sa.BigInteger(), nullable=False),
        sa.Column("mileage_km", sa.Double(), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_reprofilings_wheelset_wheelsets")),
        sa.PrimaryKeyConstraint("wheelset", "at_ns", name=op.f("pk_reprofilings")),
    )


def _trends() -> None:
    op.create_table(
        "trends",
        sa.Column("trend_id", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("baseline", sa.Integer(), nullable=False),
        sa.Column("quantity", sa.String(length=64), nullable=False),
        sa.Column("input_digest", sa.String(length=64), nullable=False),
        sa.Column("code_version", sa.Text(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.Column("status", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("points", sa.BigInteger(), nullable=False),
        sa.Column("current", sa.Double(), nullable=True),
        sa.Column("current_std", sa.Double(), nullable=True),
        sa.Column("limit_value", sa.Double(), nullable=True),
        sa.Column("slope_per_1000_km", sa.Double(), nullable=True),
        sa.Column("slope_std_per_1000_km", sa.Double(), nullable=True),
        sa.Column("distance_to_limit_p50_km", sa.Double(), nullable=True),
        sa.Column("date_of_limit_p50_ns", sa.BigInteger(), nullable=True),
        sa.Column("probability_over_limit", sa.Double(), nullable=True),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.CheckConstraint("status IN ('unestimated', 'estimated', 'invalid')", name=op.f("ck_trends_status_known")),
        sa.CheckConstraint("baseline >= 0", name=op.f("ck_trends_baseline_counted")),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_trends_wheelset_wheelsets")),
        sa.PrimaryKeyConstraint("trend_id", name=op.f("pk_trends")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_trends_wheelset_recorded_ns"), "trends", ["wheelset", "recorded_ns"], unique=False)


def _wheelset_changes() -> None:
    op.create_table(
        "wheelset_changes",
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("change", sa.BigInteger(), nullable=False),
        sa.Column("geometry_change", sa.BigInteger(), nullable=False),
        sa.ForeignKeyConstraint(
            ["wheelset"], ["wheelsets.serial"], name=op.f("fk_wheelset_changes_wheelset_wheelsets")
        ),
        sa.PrimaryKeyConstraint("wheelset", name=op.f("pk_wheelset_changes")),
    )


def _windows() -> None:
    op.create_table(
        "windows",
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("length_ns", sa.BigInteger(), nullable=False),
        sa.Column("vehicle", sa.String(length=64), nullable=False),
        sa.Column("axle", sa.Integer(), nullable=False),
        sa.Column("track_section", sa.String(length=64), nullable=True),
        sa.Column("mileage_km", sa.Double(), nullable=False),
        sa.Column("coverage", sa.Double(), nullable=True),
        sa.Column("longest_gap_s", sa.Double(), nullable=True),
        sa.Column("gaps", sa.BigInteger(), nullable=False),
        sa.Column("clipped", sa.Double(), nullable=True),
        sa.Column("invalid", sa.Double(), nullable=True),
        sa.Column("speed_min_m_s", sa.Double(), nullable=True),
        sa.Column("speed_max_m_s", sa.Double(), nullable=True),
        sa.Column("position_quality", sa.Double(), nullable=True),
        sa.Column("sensor_fault", sa.Boolean(), nullable=False),
        sa.Column("state", sa.String(length=16), nullable=False),
        sa.Column("reason", sa.Text(), nullable=False),
        sa.Column("content_digest", sa.String(length=64), nullable=False),
        sa.Column("sample_bytes", sa.BigInteger(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.CheckConstraint("state IN ('pending', 'estimated', 'refused')", name=op.f("ck_windows_state_known")),
        sa.CheckConstraint("length_ns > 0", name=op.f("ck_windows_length_positive")),
        sa.ForeignKeyConstraint(
            ["track_section"], ["track_sections.code"], name=op.f("fk_windows_track_section_track_sections")
        ),
        sa.ForeignKeyConstraint(["vehicle"], ["vehicles.code"], name=op.f("fk_windows_vehicle_vehicles")),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_windows_wheelset_wheelsets")),
        sa.PrimaryKeyConstraint("wheelset", "start_ns", name=op.f("pk_windows")),
    )
    op.create_index(
        "ix_windows_pending",
        "windows",
        ["wheelset", "start_ns"],
        unique=False,
        sqlite_where=sa.text("state = 'pending'"),
        postgresql_where=sa.text("state = 'pending'"),
    )


def _alert_events() -> None:
    op.create_table(
        "alert_events",
        sa.Column("sequence", sa.BigInteger().with_variant(sa.Integer(), "sqlite"), nullable=False),
        sa.Column("alert_id", sa.BigInteger(), nullable=False),
        sa.Column("kind", sa.String(length=16), nullable=False),
        sa.Column("alert", sa.JSON(), nullable=False),
        sa.Column("recorded_ns", sa.BigInteger(), nullable=False),
        sa.Column("actor", sa.Text(), nullable=False),
        sa.Column("note", sa.Text(), nullable=False),
        sa.Column("in_feed", sa.Boolean(), nullable=False),
        sa.CheckConstraint(
            "kind IN ('raised', 'updated', 'acknowledged', 'shelved', 'cleared', 'closed')",
            name=op.f("ck_alert_events_kind_known"),
        ),
        sa.ForeignKeyConstraint(["alert_id"], ["alerts.alert_id"], name=op.f("fk_alert_events_alert_id_alerts")),
        sa.PrimaryKeyConstraint("sequence", name=op.f("pk_alert_events")),
        sqlite_autoincrement=True,
    )
    op.create_index(op.f("ix_alert_events_alert_id"), "alert_events", ["alert_id"], unique=False)


def _wheelset_bins() -> None:
    op.create_table(
        "wheelset_bins",
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("bin", sa.Integer(), nullable=False),
        sa.Column("geometry_id", sa.BigInteger(), nullable=False),
        sa.Column("lateral_displacement_low_m", sa.Double(), nullable=False),
        sa.Column("lateral_displacement_high_m", sa.Double(), nullable=False),
        sa.Column("samples", sa.Double(), nullable=True),
        sa.Column("rolling_radius_sum_m", sa.Double(), nullable=True),
        sa.Column("rolling_radius_sum_std_m", sa.Double(), nullable=True),
        sa.Column("rolling_radius_sum_status", sa.String(length=40), nullable=False),
        sa.Column("rolling_radius_difference_m", sa.Double(), nullable=True),
        sa.Column("rolling_radius_difference_std_m", sa.Double(), nullable=True),
        sa.Column("rolling_radius_difference_status", sa.String(length=40), nullable=False),
        sa.Column("contact_angle_sum_rad", sa.Double(), nullable=True),
        sa.Column("contact_angle_sum_std_rad", sa.Double(), nullable=True),
        sa.Column("contact_angle_sum_status", sa.String(length=40), nullable=False),
        sa.Column("contact_angle_difference_rad", sa.Double(), nullable=True),
        sa.Column("contact_angle_difference_std_rad", sa.Double(), nullable=True),
        sa.Column("contact_angle_difference_status", sa.String(length=40), nullable=False),
        sa.CheckConstraint(
            "contact_angle_difference_status IN ("
            "'estimated', 'too few samples', 'a contact jump crosses the bin', 'the data cannot say')",
            name=op.f("ck_wheelset_bins_contact_angle_difference_status_known"),
        ),
        sa.CheckConstraint(
            "contact_angle_sum_status IN ("
            "'estimated', 'too few samples', 'a contact jump crosses the bin', 'the data cannot say')",
            name=op.f("ck_wheelset_bins_contact_angle_sum_status_known"),
        ),
        sa.CheckConstraint(
            "rolling_radius_difference_status IN ("
            "'estimated', 'too few samples', 'a contact jump crosses the bin', 'the data cannot say')",
            name=op.f("ck_wheelset_bins_rolling_radius_difference_status_known"),
        ),
        sa.CheckConstraint(
            "rolling_radius_sum_status IN ("
            "'estimated', 'too few samples', 'a contact jump crosses the bin', 'the data cannot say')",
            name=op.f("ck_wheelset_bins_rolling_radius_sum_status_known"),
        ),
        sa.ForeignKeyConstraint(
            ["geometry_id"],
            ["geometry_estimates.geometry_id"],
            name=op.f("fk_wheelset_bins_geometry_id_geometry_estimates"),
        ),
        sa.ForeignKeyConstraint(["wheelset"], ["wheelsets.serial"], name=op.f("fk_wheelset_bins_wheelset_wheelsets")),
        sa.PrimaryKeyConstraint("wheelset", "bin", name=op.f("pk_wheelset_bins")),
    )


def _window_bin_tables() -> None:
    op.create_table(
        "window_bin_tables",
        sa.Column("wheelset", sa.String(length=64), nullable=False),
        sa.Column("start_ns", sa.BigInteger(), nullable=False),
        sa.Column("track_version", sa.Integer(), nullable=True),
        sa.Column("window_digest", sa.String(length=64), nullable=False),
        sa.Column("parameter_key", sa.String(length=128), nullable=False),
        sa.Column("samples", sa.BigInteger(), nullable=False),
        sa.Column("packed", sa.LargeBinary(), nullable=False),
        sa.ForeignKeyConstraint(
            ["wheelset", "start_ns"],
            ["windows.wheelset", "windows.start_ns"],
            name=op.f("fk_window_bin_tables_wheelset_start_ns_windows"),
            ondelete="CASCADE",
        ),
        sa.PrimaryKeyConstraint("wheelset", "start_ns", name=op.f("pk_window_bin_tables")),
    )
