"""Bin tables: one packed a window, and the current values of each wheelset as plain rows."""

from __future__ import annotations

from sqlalchemy import BigInteger, ForeignKey, ForeignKeyConstraint, Index, String, false, text
from sqlalchemy.orm import Mapped, mapped_column

from estimation.values.geometry import BinStatus
from fleet_db.models.base import Base, Count, Digest, Nanoseconds, Packed, Real, one_of

WAITING, WAITING_PG = text("rolled = 0"), text("NOT rolled")


class WindowBinTableRow(Base):
    """The sufficient statistics of one window, packed; ``window_digest`` identifies the content of the window.

    ``content_digest`` is of the table itself. A table that is ``rolled`` is part
    of the sums of ``roll_up``, with the mileage and the digest of its share there; or of none.
    """

    __tablename__ = "window_bin_tables"
    __table_args__ = (
        ForeignKeyConstraint(["wheelset", "start_ns"], ["windows.wheelset", "windows.start_ns"], ondelete="CASCADE"),
        Index(
            "ix_window_bin_tables_waiting", "wheelset", "start_ns", sqlite_where=WAITING, postgresql_where=WAITING_PG
        ),
        Index(None, "roll_up", "start_ns"),
    )

    wheelset: Mapped[str] = mapped_column(String(64), primary_key=True)
    start_ns: Mapped[Nanoseconds] = mapped_column(primary_key=True)
    track_version: Mapped[int | None]
    window_digest: Mapped[Digest]
    parameter_key: Mapped[str] = mapped_column(String(128))
    samples: Mapped[Count]
    content_digest: Mapped[Digest | None]
    rolled: Mapped[bool] = mapped_column(server_default=false())
    roll_up: Mapped[int | None] = mapped_column(BigInteger)
    running_km: Mapped[Real | None]
    line: Mapped[Digest | None]
    packed: Mapped[Packed]


class WheelsetBinRow(Base):
    """One bin of the current geometry of a wheelset; null where nothing is known."""

    __tablename__ = "wheelset_bins"
    __table_args__ = tuple(
        one_of(f"{name}_status", BinStatus)
        for name in (
            "rolling_radius_sum",
            "rolling_radius_difference",
            "contact_angle_sum",
            "contact_angle_difference",
        )
    )

    wheelset: Mapped[str] = mapped_column(ForeignKey("wheelsets.serial"), primary_key=True)
    bin: Mapped[int] = mapped_column(primary_key=True)
    geometry_id: Mapped[Count] = mapped_column(ForeignKey("geometry_estimates.geometry_id"))
    lateral_displacement_low_m: Mapped[Real]
    lateral_displacement_high_m: Mapped[Real]
    samples: Mapped[Real | None]
    rolling_radius_sum_m: Mapped[Real | None]
    rolling_radius_sum_std_m: Mapped[Real | None]
    rolling_radius_sum_status: Mapped[str] = mapped_column(String(40))
    rolling_radius_difference_m: Mapped[Real | None]
    rolling_radius_difference_std_m: Mapped[Real | None]
    rolling_radius_difference_status: Mapped[str] = mapped_column(String(40))
    contact_angle_sum_rad: Mapped[Real | None]
    contact_angle_sum_std_rad: Mapped[Real | None]
    contact_angle_sum_status: Mapped[str] = mapped_column(String(40))
    contact_angle_difference_rad: Mapped[Real | None]
    contact_angle_difference_std_rad: Mapped[Real | None]
    contact_angle_difference_status: Mapped[str] = mapped_column(String(40))
