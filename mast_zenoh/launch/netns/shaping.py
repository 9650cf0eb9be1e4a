"""The state of a link as nftables rules and queueing disciplines. Pure: text and arguments for `nft` and `tc`.

Packets are dropped where they come in, on both sides: dropped on their way out, a sender would be told.
"""

from __future__ import annotations

from collections.abc import Mapping

from mast_zenoh.faults.network import LinkState

#: Of which a loss is counted.
_PARTS = 1_000_000

_BURST_S = 0.01
_LEAST_BURST_BYTES = 4_000  # two packets
_QUEUE_MS = 400  # what waits longer for its turn is dropped

#: So many packets may be under way in a delay: netem's usual 1000 would drop what fast links carry.
_UNDER_WAY = 100_000


def rules(states: Mapping[str, LinkState]) -> str:
    """What a namespace does with what comes in by its devices, instead of what it did before: for `nft -f -`."""
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
    """Arguments of `tc` for what a device sends at most; None takes the limit away (which fails if there is none)."""
    if bits_per_s is None:
        return ["qdisc", "del", "dev", device, "root"]
    burst = max(_LEAST_BURST_BYTES, round(bits_per_s / 8 * _BURST_S))
    shape = ["rate", f"{round(bits_per_s)}bit", "burst", f"{burst}b", "latency", f"{_QUEUE_MS}ms"]
    return ["qdisc", "replace", "dev", device, "root", "tbf", *shape]


def netem(device: str, state: LinkState) -> list[str]:
    """Arguments of `tc` for a device whose packets wait, and go out at a rate, by the kernel's netem."""
    delay = ["delay", f"{round(state.delay_ms * 1000)}us"]
    if state.jitter_ms:
        delay.append(f"{round(state.jitter_ms * 1000)}us")
    rate = [] if state.bits_per_s is None else ["rate", f"{round(state.bits_per_s)}bit"]
    return ["qdisc", "replace", "dev", device, "root", "netem", "limit", str(_UNDER_WAY), *delay, *rate]
