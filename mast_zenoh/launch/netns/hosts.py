"""The hosts of a run as network namespaces, with a link to the centre, and faults.

    centre   router, and every node that belongs to no host             10.77.0.1
    host i   its nodes; one link, to the centre                         10.77.0.(1 + i)

A link is a pair of Ethernet devices, or two TUN devices with a relay between them if it must delay packets and the
kernel has no netem. The machine's own network stays unchanged: no device, no address, no route, no rule.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

from mast_zenoh.errors import BackendError
from mast_zenoh.faults import network
from mast_zenoh.faults.network import LinkState
from mast_zenoh.launch.netns import namespaces, relay
from mast_zenoh.launch.netns.namespaces import Namespace, own_prefix, sweep
from mast_zenoh.launch.processes import end_process

CENTRE = "10.77.0.1"
_INSIDE = f"tcp/{CENTRE}:7447"
_DEVICE = "centre"  # in a host: its only device
_READY_S = 10.0
_END_S = 1.0


class Hosts:
    """Context manager that creates and removes namespaces, links and router.

    spec: the hosts and faults, from `faults.network.resolve`; rate: scene time over wall time
    logs: folder for the logs of the router and the relays

    Raises BackendError on entering if the machine does not support all of it; then nothing is left behind.
    """

    def __init__(self, spec: Mapping[str, Any], rate: float, logs: Path) -> None:
        self.spec = spec
        self.rate = rate
        self.logs = logs
        self.inside = _INSIDE  # the router's endpoint for nodes
        self.endpoint = ""  # the router's endpoint for the launcher and other clients outside
        self.done: list[dict[str, Any]] = []
        self._host_of = {node: name for name, host in spec["hosts"].items() for node in host["nodes"]}
        self._states = {name: LinkState() for name in spec["hosts"]}
        self._links: dict[str, _HostLink] = {}
        self._processes: list[_Process] = []
        self._resources = ExitStack()
        self._changing = threading.Lock()
        self._healed = threading.Event()
        self._first_frame = threading.Event()
        self._player = threading.Thread(target=self._play, name="host faults")
        self._failure: str | None = None

    def __enter__(self) -> Hosts:
        try:
            self._set_up()
        except (CalledProcessError, OSError) as error:
            self.__exit__()
            self._fail("hosts", error)
            raise BackendError(str(self._failure)) from None
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._healed.set()
        self._first_frame.set()
        if self._player.is_alive():
            self._player.join()
        self._resources.close()

    def command(self, node: str) -> list[str]:
        """Command prefix that starts a node on its host."""
        name = self._host_of.get(node)
        return (self._links[name].host if name else self._centre).command()

    def begin(self) -> None:
        """Start scene time, at the first frame; may be repeated, and from any thread."""
        self._first_frame.set()

    def heal(self) -> None:
        """Remove all faults, and skip future ones."""
        self._healed.set()
        with self._changing:
            try:
                self._apply(network.own_states(self.spec))
            except (CalledProcessError, OSError) as error:
                self._fail("healing", error)

    def problem(self) -> str | None:
        """What has failed since, if anything."""
        return self._failure or next(
            (f"{p.name} has ended: {p.last_line()}" for p in self._processes if p.ended()), None
        )

    # -- set up --------------------------------------------------------------------------------------------------

    def _set_up(self) -> None:
        sweep()
        prefix, delays_by = own_prefix(), namespaces.delays_by(network.needs(self.spec))
        self._centre = self._namespace(f"{prefix}centre")
        self._centre.ip("address", "add", f"{CENTRE}/32", "dev", "lo")
        for number, (name, host) in enumerate(self.spec["hosts"].items(), 1):
            namespace = self._namespace(f"{prefix}{number}")
            delayed_by = (host["delay_by"] or delays_by) if host["delayed"] else None
            link = _HostLink(self._centre, namespace, f"host{number}", delayed_by)
            if delayed_by == "relay":
                link.relay = self._process(f"relay_{name}", "relay", link.ends())
            else:
                peer = "peer", "name", _DEVICE, "netns", namespace.name
                self._centre.ip("link", "add", link.device, "type", "veth", *peer)
            link.address(f"10.77.0.{1 + number}")
            self._links[name] = link
        folder = tempfile.mkdtemp(prefix=prefix)  # short: so are the paths of sockets
        self._resources.callback(shutil.rmtree, folder, ignore_errors=True)
        self.endpoint = f"unixsock-stream/{folder}/router.sock"
        self._process("router", "router", [_INSIDE, self.endpoint], self._centre.command())
        self._apply(network.own_states(self.spec))
        self._player.start()

    def _namespace(self, name: str) -> Namespace:
        namespace = Namespace.make(name)
        self._resources.callback(namespace.remove)
        return namespace

    def _process(self, name: str, module: str, arguments: Sequence[str], inside: Sequence[str] = ()) -> _Process:
        command = [*inside, sys.executable, "-P", "-m", f"mast_zenoh.launch.netns.{module}", *arguments]
        process = _Process(name, command, self.logs / f"{name}.log")
        self._resources.callback(process.end)
        process.await_ready()
        self._processes.append(process)
        return process

    # -- faults --------------------------------------------------------------------------------------------------

    def _play(self) -> None:
        """Body of the thread that changes the links on schedule."""
        self._first_frame.wait()
        begun = time.monotonic()
        for step in network.steps(self.spec):
            if self._healed.wait(max(0.0, begun + step.at_s / self.rate - time.monotonic())):
                return
            with self._changing:
                if self._healed.is_set():
                    return
                try:
                    self._apply(step.states)
                except (CalledProcessError, OSError) as error:
                    self._fail(", ".join(step.states), error)
                    return
                late_s = time.monotonic() - begun - step.at_s / self.rate
                self.done.append({"at_s": step.at_s, "hosts": sorted(step.states), "late_ms": round(late_s * 1000, 3)})

    def _fail(self, activity: str, error: CalledProcessError | OSError) -> None:
        output = error.stderr if isinstance(error, CalledProcessError) else ""
        self._failure = self._failure or f"{activity}: {output.strip() or error}"

    def _apply(self, states: Mapping[str, LinkState]) -> None:
        """Set the states of links; at the centre, all cuts and losses change atomically."""
        before, self._states = self._states, {**self._states, **states}
        changed = {name: state for name, state in states.items() if state != before[name]}
        dropping = [name for name, state in changed.items() if _drops(state) != _drops(before[name])]
        if dropping:
            self._centre.nft(
                namespaces.rules({self._links[name].device: state for name, state in self._states.items()})
            )
        for name in dropping:
            self._links[name].host.nft(namespaces.rules({_DEVICE: changed[name]}))
        for name, state in changed.items():
            self._links[name].shape(before[name], state)


def _drops(state: LinkState) -> tuple[bool, float]:
    return state.cut, state.loss


class _HostLink:
    """The link of one host.

    device: its name at the centre;  delayed_by: "netem", "relay" or None
    """

    def __init__(self, centre: Namespace, host: Namespace, device: str, delayed_by: str | None) -> None:
        self.centre = centre
        self.host = host
        self.device = device
        self.delayed_by = delayed_by
        self.relay: _Process | None = None

    def ends(self) -> list[str]:
        """Namespace and device of both ends."""
        return [self.centre.name, self.device, self.host.name, _DEVICE]

    def address(self, address: str) -> None:
        """Assign addresses to both ends, with routes only to each other."""
        for namespace, device, own, peer in (
            (self.centre, self.device, CENTRE, address),
            (self.host, _DEVICE, address, CENTRE),
        ):
            namespace.ip("address", "add", own, "peer", peer, "dev", device)
            namespace.ip("link", "set", device, "up")

    def shape(self, before: LinkState, state: LinkState) -> None:
        """Apply delay and bandwidth of a state."""
        delay_changed = (state.delay_ms, state.jitter_ms) != (before.delay_ms, before.jitter_ms)
        bandwidth_changed = state.bits_per_s != before.bits_per_s
        if self.relay is not None and delay_changed:
            self.relay.send(relay.COMMAND.pack(state.delay_ms * 1e-3, state.jitter_ms * 1e-3))
        if self.delayed_by == "netem" and (delay_changed or bandwidth_changed):
            self.centre.tc(namespaces.netem(self.device, state))
            self.host.tc(namespaces.netem(_DEVICE, state))
        elif bandwidth_changed:
            self.centre.tc(namespaces.bandwidth(self.device, state.bits_per_s))
            self.host.tc(namespaces.bandwidth(_DEVICE, state.bits_per_s))


class _Process:
    """A relay or router: prints "ready", and ends when its standard input closes."""

    def __init__(self, name: str, command: Sequence[str], log: Path) -> None:
        self.name = name
        self.log = log
        with log.open("ab", buffering=0) as stderr:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=stderr,
                bufsize=0,
                start_new_session=True,
            )

    def await_ready(self) -> None:
        """Wait until the process is ready; raises BackendError if it does not start."""
        assert self._process.stdout is not None
        guard = threading.Timer(_READY_S, self._process.kill)
        guard.start()
        try:
            line = self._process.stdout.readline()
        finally:
            guard.cancel()
        if line != b"ready\n":
            self.end()
            raise BackendError(f"hosts: {self.name} did not come up: {self.last_line()}")

    def send(self, command: bytes) -> None:
        """Write to its standard input."""
        assert self._process.stdin is not None
        self._process.stdin.write(command)

    def ended(self) -> bool:
        """Whether it has ended."""
        return self._process.poll() is not None

    def last_line(self) -> str:
        """The last line of its log, or its exit code."""
        lines = self.log.read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else f"exit code {self._process.poll()}"

    def end(self) -> None:
        """Close its standard input; kill it if it does not end."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        end_process(self._process, _END_S)
        self._process.stdout.close()
