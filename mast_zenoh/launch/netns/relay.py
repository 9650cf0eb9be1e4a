"""A link with delay between two network namespaces: two TUN devices and a relay.

    python -m mast_zenoh.launch.netns.relay NAMESPACE DEVICE NAMESPACE DEVICE

Prints "ready" when both devices exist. Standard input takes `COMMAND`s: each sets the delay and the jitter (s) from
then on. The process and its devices end when standard input closes. Packets are never reordered.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import random
import select
import struct
import sys
import time
from collections import deque

COMMAND = struct.Struct("<dd")  # delay and jitter, s

_CLONE_NEWNET = 0x40000000
_TUNSETIFF = 0x400454CA
_IFF_TUN_WITHOUT_HEADER = 0x0001 | 0x1000
_PACKET_BYTES = 65536
_MAX_READS = 64  # packets read before due packets are forwarded
_MAX_QUEUED = 50_000  # packets in one direction; any more are dropped


class Direction:
    """The queue of packets in one direction, in order of arrival."""

    def __init__(self, source: int, target: int) -> None:
        self.source = source
        self.target = target
        self.waiting: deque[tuple[float, bytes]] = deque()

    def receive(self, delay_s: float, jitter_s: float) -> None:
        """Queue new packets, due after delay ± jitter but never before the last."""
        now = time.monotonic()
        for _ in range(_MAX_READS):
            try:
                packet = os.read(self.source, _PACKET_BYTES)
            except OSError:  # no more packets, or the device is down
                return
            due = now + max(0.0, delay_s + jitter_s * random.uniform(-1.0, 1.0))
            if self.waiting:
                due = max(due, self.waiting[-1][0])
            if len(self.waiting) < _MAX_QUEUED:
                self.waiting.append((due, packet))

    def forward(self) -> None:
        """Write the packets that are due."""
        now = time.monotonic()
        while self.waiting and self.waiting[0][0] <= now:
            with contextlib.suppress(OSError):  # the device is down: the packet is lost
                os.write(self.target, self.waiting.popleft()[1])


def relay(one: int, other: int, commands: int) -> None:
    """Forward packets between two TUN devices until `commands` closes."""
    delay_s = jitter_s = 0.0
    directions = {one: Direction(one, other), other: Direction(other, one)}
    while True:
        due = [direction.waiting[0][0] for direction in directions.values() if direction.waiting]
        timeout = max(0.0, min(due) - time.monotonic()) if due else None
        readable, _, _ = select.select([one, other, commands], [], [], timeout)
        for source in readable:
            if source != commands:
                directions[source].receive(delay_s, jitter_s)
            elif command := os.read(commands, COMMAND.size):
                delay_s, jitter_s = COMMAND.unpack(command)
            else:
                return
        for direction in directions.values():
            direction.forward()


def _device(namespace: str, name: str) -> int:
    """Create a TUN device in a namespace, which this thread enters.

    The device disappears when its file is closed.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    with open(f"/run/netns/{namespace}") as file:
        if libc.setns(file.fileno(), _CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), namespace)
    device = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(device, _TUNSETIFF, struct.pack("16sH22x", name.encode(), _IFF_TUN_WITHOUT_HEADER))
    return device


if __name__ == "__main__":
    devices = [_device(namespace, name) for namespace, name in (sys.argv[1:3], sys.argv[3:5])]
    with contextlib.suppress(OSError):
        os.nice(-10)  # a relay that wakes up late lengthens the delay
    print("ready", flush=True)
    relay(devices[0], devices[1], sys.stdin.fileno())
