"""Support for tests in network namespaces."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import gettempdir

import pytest

from mast_zenoh.errors import BackendError
from mast_zenoh.launch.netns import namespaces
from mast_zenoh.launch.netns.namespaces import NAMESPACES


def require(*needs: str) -> None:
    """Skip the test, or fail if MAST_TEST_NETWORK is set, unless all needs are met."""
    try:
        namespaces.delays_by({need: ["this test"] for need in needs})
    except BackendError as error:
        if os.environ.get("MAST_TEST_NETWORK"):
            raise
        pytest.skip(str(error))


def leftovers_of(pid: int) -> list[str]:
    """The namespaces and folders left by the launcher with this pid."""
    return [path.name for folder in (NAMESPACES, Path(gettempdir())) for path in folder.glob(f"mast-{pid}-*")]


def machine_network() -> list[str]:
    """The machine's own devices, addresses, routes and rules."""
    commands = (["ip", "-o", "link"], ["ip", "-o", "address"], ["ip", "route"], ["nft", "list", "ruleset"])
    return [subprocess.run(command, capture_output=True, text=True, check=True).stdout for command in commands]


class Echo:
    """A UDP echo server in a namespace; it ends when its standard input closes."""

    PROGRAM = (
        "import select, socket, sys\n"
        "s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "s.bind(('0.0.0.0', 7000))\n"
        "print('ready', flush=True)\n"
        "while sys.stdin not in select.select([s, sys.stdin], [], [])[0]:\n"
        "    s.sendto(*s.recvfrom(9000))\n"
    )
    ASK = (
        "import socket, sys, time\n"
        "address, count, timeout_s, size = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4])\n"
        "s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "s.settimeout(timeout_s)\n"
        "for number in range(count):\n"
        "    sent, packet = time.monotonic(), number.to_bytes(4, 'big') * (size // 4)\n"
        "    s.sendto(packet, (address, 7000))\n"
        "    try:\n"
        "        while s.recv(9000) != packet: pass\n"
        "        print(1000 * (time.monotonic() - sent))\n"
        "    except TimeoutError: pass\n"
    )

    def __init__(self, namespace_command: Sequence[str]) -> None:
        command = [*namespace_command, sys.executable, "-c", self.PROGRAM]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == b"ready\n"

    def __enter__(self) -> Echo:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate()

    @classmethod
    def ask(
        cls, namespace_command: Sequence[str], address: str, count: int, timeout_s: float = 1.0, size: int = 100
    ) -> list[float]:
        """Round-trip times, ms, of sequential packets that returned in time."""
        arguments = [address, str(count), str(timeout_s), str(size)]
        command = [*namespace_command, sys.executable, "-c", cls.ASK, *arguments]
        return [float(line) for line in subprocess.run(command, capture_output=True, check=True).stdout.splitlines()]
