"""What this machine can do to a network, found out by trying it in a namespace of its own."""

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


def delays_by(wanted: Mapping[str, Iterable[str]], owner: Owner) -> str:
    """What delays packets here where the user leaves the choice: "netem" or "relay".

    wanted: what the run needs, as `faults.network.needs` says it

    Raises BackendError if this machine lacks any of what is wanted: names it, who wants it, and what to install.
    """
    if not shutil.which("ip"):
        raise BackendError(f"{_who(wanted)}: no program `ip` on this machine: install iproute2")
    try:
        probe = Namespace.make(owner.name("probe"))
    except CalledProcessError as error:
        said = error.stderr.strip()
        raise BackendError(
            f"{_who(wanted)}: this machine makes no network namespaces ({said}): run as root, or with the "
            "capabilities CAP_SYS_ADMIN and CAP_NET_ADMIN"
        ) from None
    try:
        has_netem = _why_not(probe, "netem") is None
        choice = "netem" if has_netem else "relay"
        for need, hosts in wanted.items():
            if reason := _why_not(probe, choice if need == "delay" else need):
                raise BackendError(f"{need} of {', '.join(hosts)}: {reason}")
        return choice
    finally:
        probe.remove()


def _who(wanted: Mapping[str, Iterable[str]]) -> str:
    return "; ".join(f"{need} of {', '.join(hosts)}" for need, hosts in wanted.items()) or "hosts"


def _why_not(probe: Namespace, need: str) -> str | None:
    """Why this machine cannot do something, and what would help; None if it can."""
    attempt, help_ = _ATTEMPTS[need]
    try:
        attempt(probe)
    except FileNotFoundError as error:
        return f"{error.filename} is missing: {help_}"
    except CalledProcessError as error:
        said = error.stderr.strip() or str(error)
        return f"{said.splitlines()[0].rstrip('.')}: {help_}"
    except OSError as error:
        return f"{error}: {help_}"
    return None


def _open_tun(probe: Namespace) -> None:
    os.close(os.open(_TUN, os.O_RDWR))


#: What is needed, how to try it, and what helps who lacks it.
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
