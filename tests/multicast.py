"""Whether this machine has the multicast bus of the tests."""

from __future__ import annotations

import socket

GROUP = "239.74.163.77"


def multicast_problem() -> str:
    """Why there is no multicast here; empty where there is."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            receiver.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            receiver.bind(("", 0))
            receiver.setsockopt(
                socket.IPPROTO_IP,
                socket.IP_ADD_MEMBERSHIP,
                socket.inet_aton(GROUP) + socket.inet_aton("0.0.0.0"),  # noqa: S104 - any interface
            )
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                sender.sendto(b"?", (GROUP, receiver.getsockname()[1]))
            receiver.settimeout(2.0)
            receiver.recv(1)
    except OSError as error:
        return f"no multicast on this machine: {error}"
    return ""
