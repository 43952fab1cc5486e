"""Ports of this machine that a simulated vehicle is reached at."""

from __future__ import annotations

import socket

from flighttest.errors import LinkError


def listen(host: str, port: int) -> socket.socket:
    """A TCP socket that listens on host:port (0: any free port); LinkError where it cannot."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        raise LinkError(f"cannot listen on tcp {host}:{port}: {error.strerror}", "choose another --port") from error
    sock.listen(8)
    return sock


def bind_datagrams(host: str, port: int) -> socket.socket:
    """A UDP socket bound to host:port (0: any free port); LinkError where it cannot."""
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 20)
    try:
        sock.bind((host, port))
    except OSError as error:
        sock.close()
        raise LinkError(f"cannot bind udp {host}:{port}: {error.strerror}", "choose another --port") from error
    return sock
