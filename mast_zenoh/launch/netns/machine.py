"""Finds out which network effects this machine supports, in a probe namespace."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from subprocess import CalledProcessError

from mast_zenoh.errors import BackendError
from mast_zenoh.faults.network import LinkState
from mast_zenoh.launch.netns.namespaces import Namespace, Owner
from mast_zenoh.launch.netns.shaping import bandwidth, netem, rules

_TUN = "/dev/net/tun"


def delays_by(required: Mapping[str, Iterable[str]], owner: Owner) -> str:
    """How packets are delayed here by default: "netem" or "relay".

    required: the effects that the run needs and their hosts, from `faults.network.needs`

    Raises BackendError, with effect, hosts and what to install, if this machine lacks a required effect.
    """
    if not shutil.which("ip"):
        raise BackendError(f"{_description(required)}: no program `ip` on this machine: install iproute2")
    try:
        probe = Namespace.make(owner.name("probe"))
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
