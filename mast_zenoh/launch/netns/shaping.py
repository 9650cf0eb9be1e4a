"""The state of a link as text and arguments for `nft` and `tc`, and which of them this machine supports.

Packets are dropped on input, at both ends: if they were dropped on output, the sender would get an error."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from subprocess import CalledProcessError

from mast_zenoh.errors import BackendError
from mast_zenoh.faults.network import LinkState
from mast_zenoh.launch.netns.namespaces import Namespace, own_prefix

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


_TUN = "/dev/net/tun"


def delays_by(required: Mapping[str, Iterable[str]]) -> str:
    """How packets are delayed here by default: "netem" or "relay".

    required: the effects that the run needs and their hosts, from `faults.network.needs`

    Raises BackendError, with effect, hosts and what to install, if this machine lacks a required effect.
    """
    if not shutil.which("ip"):
        raise BackendError(f"{_description(required)}: no program `ip` on this machine: install iproute2")
    try:
        probe = Namespace.make(f"{own_prefix()}probe")
    except CalledProcessError as error:
        output = error.stderr.strip()
        raise BackendError(
            f"{_description(required)}: this machine cannot create network namespaces ({output}): run as root, or with "
            "the capabilities CAP_SYS_ADMIN and CAP_NET_ADMIN"
        ) from None
    try:
        has_netem = _obstacle(probe, "netem") is None
        choice = "netem" if has_netem else "relay"
        for effect, hosts in required.items():
            if reason := _obstacle(probe, choice if effect == "delay" else effect):
                raise BackendError(f"{effect} of {', '.join(hosts)}: {reason}")
        return choice
    finally:
        probe.remove()


def _description(required: Mapping[str, Iterable[str]]) -> str:
    return "; ".join(f"{effect} of {', '.join(hosts)}" for effect, hosts in required.items()) or "hosts"


def _obstacle(probe: Namespace, effect: str) -> str | None:
    """Why this machine does not support an effect, and a remedy; None if it does."""
    attempt, remedy = _ATTEMPTS[effect]
    try:
        attempt(probe)
    except FileNotFoundError as error:
        return f"{error.filename} is missing: {remedy}"
    except CalledProcessError as error:
        output = error.stderr.strip() or str(error)
        return f"{output.splitlines()[0].rstrip('.')}: {remedy}"
    except OSError as error:
        return f"{error}: {remedy}"
    return None


def _open_tun(probe: Namespace) -> None:
    os.close(os.open(_TUN, os.O_RDWR))


#: By effect: a function that tries it, and the remedy if that fails.
_ATTEMPTS: dict[str, tuple[Callable[[Namespace], object], str]] = {
    "partition": (
        lambda probe: probe.nft(rules({"lo": LinkState(cut=True)})),
        "install nftables, and a kernel with nf_tables",
    ),
    "loss": (
        lambda probe: probe.nft(rules({"lo": LinkState(loss=0.5)})),
        "install nftables, and a kernel with nf_tables and nft_numgen",
    ),
    "bandwidth": (lambda probe: probe.tc(bandwidth("lo", 1e6)), "install iproute2, and a kernel with sch_tbf"),
    "netem": (
        lambda probe: probe.tc(netem("lo", LinkState(delay_ms=1.0))),
        "install iproute2, and a kernel with sch_netem; or leave out delay_by: a relay in user space does it",
    ),
    "relay": (_open_tun, f"load the kernel module tun, or give the container the device {_TUN}"),
}
