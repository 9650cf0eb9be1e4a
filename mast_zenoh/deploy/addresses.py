"""Addresses and ports of this machine, and how they are written in endpoints."""

from __future__ import annotations

import socket


def free_port() -> int:
    """A TCP port of this machine at which nothing listens."""
    with socket.socket() as probe:
        probe.bind(("", 0))
        return int(probe.getsockname()[1])


def is_local(address: str) -> bool:
    """Whether this machine can listen at an address."""
    try:
        family, kind, protocol, _, endpoint = socket.getaddrinfo(address, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.bind(endpoint)
    except OSError:
        return False
    return True


def bracketed(address: str) -> str:
    """An address as endpoints have it: an IPv6 address in brackets."""
    return f"[{address}]" if ":" in address else address
