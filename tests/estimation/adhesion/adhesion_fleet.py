"""What tests of the adhesion job share."""

from __future__ import annotations

from dataclasses import dataclass

from api.settings import Settings
from ingest.simulator.scenario import Scenario


@dataclass(frozen=True, slots=True)
class EstimatedFleet:
    """A scenario and a deployment that has received and estimated it; tests work on copies."""

    scenario: Scenario
    settings: Settings
