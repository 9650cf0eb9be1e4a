"""Network namespaces that belong to one launcher, and commands inside them.

A namespace's name identifies its launcher, so that a killed launcher's namespaces can be removed. The machine's own
namespace is not changed.

The state of a link as text and arguments for `nft` and `tc`, and which of them this machine supports.

Packets are dropped on input, at both ends: if they were dropped on output, the sender would get an error.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from subprocess import CalledProcessError

from mast_zenoh.errors import BackendError
from mast_zenoh.faults.network import LinkState
from mast_zenoh.launch.liveness import began

NAMESPACES = Path("/run/netns")

_NAME = re.compile(r"mast-(?P<pid>\d+)-(?P<started>\d+)-\d+-.*")
_COUNTER = itertools.count()


def own_prefix() -> str:
    """Begins the names of a set of namespaces of this process; a new one at each call."""
    pid = os.getpid()
    return f"mast-{pid}-{began(pid)}-{next(_COUNTER)}-"


class Namespace:
    """A network namespace by its name."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.path = NAMESPACES / name

    @classmethod
    def make(cls, name: str) -> Namespace:
        """Create a namespace. Raises CalledProcessError if that fails."""
        _run(["ip", "netns", "add", name])
        namespace = cls(name)
        namespace.ip("link", "set", "lo", "up")
        return namespace

    def command(self) -> list[str]:
        """Command prefix that runs a command inside, under the same process id."""
        return ["ip", "netns", "exec", self.name]

    def ip(self, *arguments: str) -> None:
        """Run `ip` inside."""
        _run(["ip", "-n", self.name, *arguments])

    def tc(self, arguments: list[str]) -> None:
        """Run `tc` inside."""
        _run(["tc", "-n", self.name, *arguments])

    def nft(self, rules: str) -> None:
        """Apply rules inside with `nft`, all or none of them."""
        if not shutil.which("nft"):
            raise FileNotFoundError(2, "No such file or directory", "nft")
        _run([*self.command(), "nft", "-f", "-"], rules)

    def remove(self) -> None:
        """Delete the name; the namespace itself ends with its last process."""
        subprocess.run(["ip", "netns", "del", self.name], capture_output=True, check=False)


def sweep() -> list[str]:
    """Remove namespaces and folders of killed launchers; return their names."""
    parents = NAMESPACES, Path(tempfile.gettempdir())
    paths = [path for parent in parents for path in parent.glob("mast-*")]
    owned = [(path, match) for path in paths if (match := _NAME.fullmatch(path.name))]
    stale = [path for path, match in owned if began(int(match["pid"])) != match["started"]]
    for path in stale:
        if path.parent == NAMESPACES:
            Namespace(path.name).remove()
        else:
            shutil.rmtree(path, ignore_errors=True)
    return [path.name for path in stale]


def _run(command: list[str], stdin: str | None = None) -> None:
    subprocess.run(command, input=stdin, capture_output=True, text=True, check=True)


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
