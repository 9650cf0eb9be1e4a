"""Starts, watches, restarts and ends the nodes of a run, wherever they live."""

from __future__ import annotations

import signal
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from typing import Any, Generic, TypeVar

from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import BackendError

MAX_RESTARTS = 5


class Child(ABC):
    """A node's process and its state."""

    def __init__(self, name: str, spec: NodeSpec) -> None:
        self.name = name
        self.spec = spec
        self.restarts = 0
        self.exit_handled = False  # whether `newly_ended` has returned it
        self.exit_expected = False  # whether the scenario or an interception ends it
        self.handed_in = False  # whether it has given its results to the launcher
        self.paused = False
        self.cut_off = False  # whether it is disconnected from its networks
        self.notes: list[str] = []

    @property
    def cpu_s(self) -> float | None:
        """Processor time of its process so far, s, as its supervisor measures it; None if it cannot."""
        return None

    @property
    @abstractmethod
    def exit(self) -> int | None:
        """Exit code, negative for a signal; None while it runs."""

    @abstractmethod
    def where(self) -> dict[str, Any]:
        """Its location for run.json, such as its process id."""

    @property
    def ended(self) -> str:
        """How it ended, in words: "ok" only if it has handed in its results."""
        no_results = self.exit == 0 and not self.handed_in
        ending = "exit code 0, but it handed in no results" if no_results else how_ended(self.exit)
        return "; ".join([*self.notes, ending])


def how_ended(code: int | None) -> str:
    """An exit code in words."""
    if code is None:
        return "running"
    if code == 0:
        return "ok"
    return f"killed by signal {-code} ({signal.Signals(-code).name})" if code < 0 else f"exit code {code}"


#: The class of a supervisor's processes.
C = TypeVar("C", bound=Child)


class Supervisor(ABC, Generic[C]):
    """The nodes of a run, by name; ends only nodes that it has started.

    A subclass knows how to reach them: as processes, in containers, on other hosts.
    """

    def __init__(self) -> None:
        self.children: dict[str, C] = {}

    @abstractmethod
    def start(self, name: str, spec: NodeSpec) -> None:
        """Start a node."""

    def start_all(self, specs: Mapping[str, NodeSpec]) -> None:
        """Start several nodes."""
        for name, spec in specs.items():
            self.start(name, spec)

    def restart(self, child: C) -> bool:
        """Restart a node that has ended; False if it has been restarted too often.

        The limit does not apply to restarts by the scenario.
        """
        if child.restarts >= MAX_RESTARTS and not child.exit_expected:
            return False
        child.notes.append(how_ended(child.exit))
        child.restarts += 1
        child.exit_handled = child.exit_expected = child.paused = child.handed_in = False
        self._restart(child)
        return True

    @abstractmethod
    def _restart(self, child: C) -> None:
        """Start a node that has ended."""

    @abstractmethod
    def end_now(self, child: C) -> None:
        """Kill a node, and wait until it has ended."""

    def kill(self, child: C) -> None:
        """Kill a node on behalf of the scenario."""
        child.exit_expected = True
        child.notes.append("killed by the scenario")
        self.end_now(child)

    def pause(self, child: C) -> None:
        """Suspend a node until it is resumed."""
        child.paused = True  # set first: suspending may fail halfway
        self._suspend(child)

    @abstractmethod
    def _suspend(self, child: C) -> None:
        """Suspend a running node."""

    def resume(self, children: Iterable[C]) -> None:
        """Resume the nodes that are paused."""
        paused = [child for child in children if child.paused]
        for child in paused:
            child.paused = False
        self._resume(paused)

    @abstractmethod
    def _resume(self, children: Iterable[C]) -> None:
        """Resume paused nodes, unless they have ended since."""

    def disconnect(self, child: C) -> None:
        """Disconnect a node from its networks; raises BackendError if that is impossible."""
        raise BackendError(f"{child.name} cannot be disconnected: only engine compose gives nodes their own networks")

    def connect(self, children: Iterable[C]) -> None:
        """Reconnect the nodes that were disconnected."""
        assert not any(child.cut_off for child in children)

    def dispose(self, child: C) -> None:
        """Release the resources of a node that has ended for good, if it has any until the end of the run."""

    @abstractmethod
    def end(self, grace_s: float) -> None:
        """End all nodes: resume and reconnect, then ask, terminate and kill them.

        grace_s: s to wait after each of these
        """

    def is_started(self, name: str) -> bool:
        """Whether a node that asks for its files is to run; only a process that nobody here starts asks earlier."""
        return True

    def newly_ended(self) -> list[C]:
        """Nodes that have ended since the last call."""
        ended = [child for child in self.children.values() if not child.exit_handled and child.exit is not None]
        for child in ended:
            child.exit_handled = True
        return ended

    def running(self) -> list[C]:
        """Nodes that are running."""
        return [child for child in self.children.values() if child.exit is None]

    def to_json(self, reports: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        """The `nodes` part of run.json; `reports`: what the nodes have handed in.

        Keys:
        role, log: of the node; its log in the run folder
        pid, container, host: its process, or where it was deployed
        exit, ended: exit code, and how it ended in words
        restarts: how often it was started again
        last_frame, cpu_s: the last frame that it handled; processor time
        rejected, first_rejected: messages that it refused, by key; frame and reason of the first ones
        unaccepted: keys on which nothing came but messages that it refused
        foreign: messages that no node of the run sent, by key
        failures: handlers that raised an exception: `handler`, `count`, `frames`, `exception` and `where`
        invalid_control, unsigned_control: control messages that it refused; number of those obeyed unsigned
        clock, versions: on another host, how far its clock is ahead, and the versions there
        """
        reported_keys = ("last_frame", "cpu_s", "rejected", "first_rejected", "unaccepted", "foreign", "failures")
        return {
            name: {
                "role": child.spec.role,
                **child.where(),
                "exit": child.exit,
                "ended": child.ended,
                "restarts": child.restarts,
                "log": f"logs/{name}.log",
                **{key: reports.get(name, {}).get(key) for key in reported_keys},
                "invalid_control": reports.get(name, {}).get("invalid"),
                "unsigned_control": reports.get(name, {}).get("unsigned"),
                **{key: reports[name][key] for key in ("clock", "versions") if key in reports.get(name, {})},
            }
            for name, child in self.children.items()
        }
