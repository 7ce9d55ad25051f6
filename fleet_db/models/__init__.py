"""Tables, one file a subject."""

from fleet_db.models.access import ApiKeyRow, AuditRow
from fleet_db.models.adhesion import SectionAdhesionRow, WindowAdhesionRow
from fleet_db.models.alerts import AlertEventRow, AlertRow
from fleet_db.models.base import Base
from fleet_db.models.bin_tables import WheelsetBinRow, WindowBinTableRow
from fleet_db.models.chunks import ChunkRow
from fleet_db.models.dampers import GearDamperRow, WindowDamperRow
from fleet_db.models.feed_branches import FeedBranchRow
from fleet_db.models.fleets import FleetRow
from fleet_db.models.geometries import GeometryRow
from fleet_db.models.idempotency import IdempotencyRow
from fleet_db.models.job_owners import JobOwnerRow
from fleet_db.models.jobs import JobRunRow
from fleet_db.models.looks import LookRow
from fleet_db.models.measured_profiles import MeasuredProfilesRow
from fleet_db.models.mountings import MountingRow
from fleet_db.models.purges import PurgeRow
from fleet_db.models.quarantine import QuarantineRow, RawMarkRow, RecordingChangeRow
from fleet_db.models.rails import RailCellRow, SectionRailsRow, WheelsetRailsRow
from fleet_db.models.raw_scrubs import RawScrubRow
from fleet_db.models.registry_history import RegistryEventRow
from fleet_db.models.roll_ups import RollingSumsRow, RollUpRow, RollUpStateRow, TakenTableRow
from fleet_db.models.section_looks import SectionChangeRow, SectionLookRow
from fleet_db.models.sensor_changes import SensorChangeRow
from fleet_db.models.settings import StoredSettingRow
from fleet_db.models.signatures import SignatureAnswerRow, WearSignatureRow
from fleet_db.models.stale_spans import StaleSpanRow
from fleet_db.models.suspension import SuspensionFindingRow
from fleet_db.models.track_epochs import TrackEpochRow, TrackEpochVehicleRow, TrackEpochWindowRow
from fleet_db.models.tracks import (
    TrackAlignmentRow,
    TrackLayoutRow,
    TrackReportRow,
    TrackSectionRow,
    TrackVersionRow,
    WindowPositionRow,
)
from fleet_db.models.trends import TrendRow
from fleet_db.models.vehicle_classes import VehicleClassRow
from fleet_db.models.vehicles import VehicleRow
from fleet_db.models.webhooks import WebhookDeliveryRow, WebhookFleetRow, WebhookRow, WebhookSecretRow
from fleet_db.models.wheelsets import ReprofilingRow, WheelsetChangeRow, WheelsetRow
from fleet_db.models.windows import WindowRow
from fleet_db.models.work_claims import WorkClaimRow, WorkLeaseRow
from fleet_db.models.worklist import WorklistAlertRow, WorklistEntryRow

__all__ = [
    "AlertEventRow",
    "AlertRow",
    "ApiKeyRow",
    "AuditRow",
    "Base",
    "ChunkRow",
    "FeedBranchRow",
    "FleetRow",
    "GearDamperRow",
    "GeometryRow",
    "IdempotencyRow",
    "JobOwnerRow",
    "JobRunRow",
    "LookRow",
    "MeasuredProfilesRow",
    "MountingRow",
    "PurgeRow",
    "QuarantineRow",
    "RailCellRow",
    "RawMarkRow",
    "RawScrubRow",
    "RecordingChangeRow",
    "RegistryEventRow",
    "ReprofilingRow",
    "RollUpRow",
    "RollUpStateRow",
    "RollingSumsRow",
    "SectionAdhesionRow",
    "SectionChangeRow",
    "SectionLookRow",
    "SectionRailsRow",
    "SensorChangeRow",
    "SignatureAnswerRow",
    "StaleSpanRow",
    "StoredSettingRow",
    "SuspensionFindingRow",
    "TakenTableRow",
    "TrackAlignmentRow",
    "TrackEpochRow",
    "TrackEpochVehicleRow",
    "TrackEpochWindowRow",
    "TrackLayoutRow",
    "TrackReportRow",
    "TrackSectionRow",
    "TrackVersionRow",
    "TrendRow",
    "VehicleClassRow",
    "VehicleRow",
    "WearSignatureRow",
    "WebhookDeliveryRow",
    "WebhookFleetRow",
    "WebhookRow",
    "WebhookSecretRow",
    "WheelsetBinRow",
    "WheelsetChangeRow",
    "WheelsetRailsRow",
    "WheelsetRow",
    "WindowAdhesionRow",
    "WindowBinTableRow",
    "WindowDamperRow",
    "WindowPositionRow",
    "WindowRow",
    "WorkClaimRow",
    "WorkLeaseRow",
    "WorklistAlertRow",
    "WorklistEntryRow",
]
