"""Fleets: who operates what."""

from __future__ import annotations

from typing import Annotated

from sqlalchemy import String
from sqlalchemy.orm import Mapped, mapped_column

from fleet_db.models.base import Base, Name

FleetKey = Annotated[str, mapped_column(String(64), primary_key=True)]


class FleetRow(Base):
    """One fleet."""

    __tablename__ = "fleets"

    code: Mapped[FleetKey]
    name: Mapped[Name]
