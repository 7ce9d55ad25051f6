"""Live buses through python-can: open them, and send at the pace of the stamps. ``ingest.live`` receives them.

``virtual`` works inside one process, ``udp_multicast`` between processes and machines, ``socketcan`` on a vehicle.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import can
import numpy as np

from estimation.errors import ConflictError, ParameterError
from ingest.catalogue import SYNC_ID
from ingest.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG, FrameBatch

VIRTUAL = "virtual"
MULTICAST = "udp_multicast"
INTERFACES = (VIRTUAL, MULTICAST, "socketcan")

RECEIVE_BYTES = 1 << 22
"""Of the socket: seconds of frames wait there while this process is held up. The kernel may grant less."""

IDENTIFIER_BITS = 0x1FFF_FFFF

_IP_MULTICAST_ALL, _IPV6_MULTICAST_ALL = 49, 29  # linux/in.h, linux/in6.h
_SO_RCVBUFFORCE = 33  # asm-generic/socket.h: beyond net.core.rmem_max, where this process may


def open_bus(interface: str, channel: str, **options: Any) -> can.BusABC:  # noqa: ANN401 - python-can's own options
    """Open a bus; use it as a context manager."""
    if interface not in INTERFACES:
        raise ParameterError(f"is {interface!r}; known are {', '.join(INTERFACES)}", field="interface")
    try:
        bus = can.Bus(channel=channel, interface=interface, **options)
    except (can.CanError, OSError, ValueError, NotImplementedError) as error:
        raise ParameterError(f"{interface} bus {channel!r} cannot be opened: {error}", field="channel") from error
    if interface != VIRTUAL:
        with socket.socket(fileno=os.dup(bus.fileno())) as end:
            try:
                end.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BYTES)
            except OSError:
                end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BYTES)
            if interface == MULTICAST:
                _hear_own_group_alone(end)
    return bus


def _hear_own_group_alone(end: socket.socket) -> None:
    """Leave out what is sent to groups that other sockets of this machine have joined on the same port.

    Linux hands a datagram of any joined group to every socket on its port unless this is switched off.
    """
    if not sys.platform.startswith("linux"):
        return
    if end.family == socket.AF_INET6:
        end.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
    else:
        end.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)


def send(
    bus: can.BusABC,
    batch: FrameBatch,
    *,
    stop: threading.Event | None = None,
    clock_s: Callable[[], float] = time.monotonic,
) -> int:
    """Send frames at the pace of their time stamps, the first at once; return how many were sent.

    The frames of a cycle go out right behind their SYNC: a pause between them could grow beyond the cycle.
    """
    if len(batch) == 0:
        return 0
    begin, ended = clock_s(), stop or threading.Event()
    due = begin + (batch.t_ns - batch.t_ns[0]) * 1e-9
    sync = np.maximum.accumulate(np.where(batch.arbitration_id == SYNC_ID, np.arange(len(batch)), -1))
    due[sync >= 0] = due[sync[sync >= 0]]
    for position, message in enumerate(messages_of(batch)):
        ahead = float(due[position]) - clock_s()
        if ahead > 0.0:
            ended.wait(ahead)
        if ended.is_set():
            return position
        try:
            bus.send(message)
        except can.CanError as error:
            raise ConflictError(f"the bus refused a frame: {error}", kind="bus") from error
    return len(batch)


def messages_of(batch: FrameBatch) -> Iterator[can.Message]:
    """Yield the frames of a batch as python-can's messages."""
    columns = (batch.t_ns.tolist(), batch.arbitration_id.tolist(), batch.dlc.tolist(), batch.data)
    for t_ns, identifier, length, data in zip(*columns, strict=True):
        remote = bool(identifier & REMOTE_FLAG)
        yield can.Message(
            timestamp=t_ns / 1e9,
            arbitration_id=identifier & IDENTIFIER_BITS,
            is_extended_id=bool(identifier & EXTENDED_FLAG),
            is_remote_frame=remote,
            is_error_frame=bool(identifier & ERROR_FLAG),
            dlc=length,
            data=None if remote else data[:length].tobytes(),
        )
