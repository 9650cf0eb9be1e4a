"""The state of a link as text and arguments for `nft` and `tc`.

Packets are dropped on input, at both ends: if they were dropped on output, the sender would get an error.
"""

from __future__ import annotations

from collections.abc import Mapping

from mast_zenoh.faults.network import LinkState

#: Resolution of a loss.
_PARTS = 1_000_000

_BURST_S = 0.01
_MIN_BURST_BYTES = 4_000  # two packets
_QUEUE_MS = 400  # packets that would wait longer are dropped

#: Capacity of a delay in packets: netem's default of 1000 would drop packets of fast links.
_MAX_QUEUED = 100_000


def rules(states: Mapping[str, LinkState]) -> str:
    """Rules for the input of a namespace's devices, which replace all earlier ones.

    For `nft -f -`.
    """
    lines = [
        "add table inet mast",
        "delete table inet mast",
        "add table inet mast",
        "add chain inet mast input { type filter hook input priority 0 ; policy accept ; }",
    ]
    for device, state in states.items():
        if state.cut:
            lines.append(f'add rule inet mast input iifname "{device}" drop')
        elif lost := round(state.loss * _PARTS):
            lines.append(f'add rule inet mast input iifname "{device}" numgen random mod {_PARTS} < {lost} drop')
    return "\n".join(lines) + "\n"


def bandwidth(device: str, bits_per_s: float | None) -> list[str]:
    """Arguments of `tc` for a device's bandwidth; None removes the limit.

    `tc` fails if there is no limit to remove.
    """
    if bits_per_s is None:
        return ["qdisc", "del", "dev", device, "root"]
    burst = max(_MIN_BURST_BYTES, round(bits_per_s / 8 * _BURST_S))
    shape = ["rate", f"{round(bits_per_s)}bit", "burst", f"{burst}b", "latency", f"{_QUEUE_MS}ms"]
    return ["qdisc", "replace", "dev", device, "root", "tbf", *shape]


def netem(device: str, state: LinkState) -> list[str]:
    """Arguments of `tc` for delay and rate of a device, with the kernel's netem."""
    delay = ["delay", f"{round(state.delay_ms * 1000)}us"]
    if state.jitter_ms:
        delay.append(f"{round(state.jitter_ms * 1000)}us")
    rate = [] if state.bits_per_s is None else ["rate", f"{round(state.bits_per_s)}bit"]
    return ["qdisc", "replace", "dev", device, "root", "netem", "limit", str(_MAX_QUEUED), *delay, *rate]
