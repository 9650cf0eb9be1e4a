"""Plays a whole run, launcher included, in one thread and in virtual time."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from mast_zenoh.control.failures import Entry
from mast_zenoh.control.interception import Release
from mast_zenoh.launch.launcher_protocol import churn_of
from mast_zenoh.testing.simulation.launcher import SimulatedLauncher
from mast_zenoh.testing.simulation.network import LEASE_NS, S
from mast_zenoh.testing.simulation.processes import SimulatedMesh, SimulatedProcess
from mast_zenoh.testing.simulation.world import Disturbance, Schedule, SimulatedWorld

LONGEST_S = 400.0  #: virtual time by which every run has ended


@dataclass
class SimulationOutcome:
    """How a simulated run has ended.

    ended:   whether it has;  launcher_lost: whether the launcher was killed
    error:   class name and text of the run's error; "" for none
    results: of each node's `finish`; frames: number played;  churn: lost and returned nodes
    died:    nodes of which a process did not end by itself
    lost:    nodes that ended without results, with how; not those that the scenario or an interception ended
    rejected: numbers of rejected messages, by node
    failures: of handlers, by node, see control.failures
    notes:   lines that the launcher showed;  seconds: of virtual time;  events: number of calls that were played
    missed:  disturbances that met nothing: after the end, or when their process was not there
    changes, refused: changes of the wiring, and requests that were refused
    streams: digest of all messages sent on each key, in their order
    on_the_way: number of messages that had not arrived when the run ended
    violations: broken promises that were seen while it was played
    """

    ended: bool
    launcher_lost: bool
    error: str
    results: dict[str, dict[str, Any]]
    frames: int
    churn: list[dict[str, Any]]
    died: set[str]
    lost: dict[str, str]
    rejected: dict[str, dict[str, int]]
    failures: dict[str, list[Entry]]
    changes: list[dict[str, Any]]
    refused: list[str]
    notes: list[str]
    seconds: float
    events: int
    streams: dict[str, bytes]
    on_the_way: int
    missed: list[Disturbance]
    violations: list[str] = field(default_factory=list)

    def claims_to_be_exact(self, undisturbed: SimulationOutcome | None = None) -> bool:
        """Whether nothing in its record says that it differs from the undisturbed run; None: which rejects nothing."""
        complete = self.ended and not self.launcher_lost and not self.error
        rejected = {name: counts for name, counts in self.rejected.items() if counts}
        expected = {name: counts for name, counts in undisturbed.rejected.items() if counts} if undisturbed else {}
        return complete and not self.churn and not self.lost and rejected == expected


class Simulation(SimulatedMesh):
    """One run of a world with a schedule."""

    launcher: SimulatedLauncher

    def __init__(self, world: SimulatedWorld, schedule: Schedule) -> None:
        super().__init__(world, schedule)
        self.launcher = SimulatedLauncher(self)
        self._pending: list[Disturbance | None] = list(schedule.disturbances)
        for number, disturbance in enumerate(schedule.disturbances):
            self.time.after(disturbance.at_s, self._disturb, number)

    def play(self) -> SimulationOutcome:
        """Play the run to its end."""
        self.launcher.begin()
        resolved = self.world.resolved
        most = 20_000 + 1_000 * resolved.frames * len(resolved.nodes)
        ended = self.time.run(round(LONGEST_S * S), most, self._is_over)
        if not ended:
            running = [f"{process.name} ({process.protocol.state.value})" for process in self.running()]
            longest = f"{LONGEST_S:g} s, or {most} events"
            self.violate(f"the run has not ended after {longest}: {', '.join(running)}")
        launcher = self.launcher
        driver = next((outcome for outcome in launcher.outcomes.values() if "sent_ns" in outcome), {})
        problem = launcher.state.stop.problem
        children = launcher.supervisor.children.values()
        return SimulationOutcome(
            ended=ended,
            launcher_lost=not launcher.alive,
            error=f"{type(problem).__name__}: {problem}" if problem else "",
            results={name: outcome["results"] for name, outcome in launcher.outcomes.items()},
            frames=driver.get("frames", 0),
            churn=churn_of(launcher.outcomes, launcher.state) if driver else [],
            died={process.name for process in self.network.processes if process.exit},
            lost={child.name: child.ended for child in children if not child.handed_in and not child.exit_expected},
            rejected={name: outcome["rejected"] for name, outcome in launcher.outcomes.items()},
            failures={name: outcome["failures"] for name, outcome in launcher.outcomes.items() if outcome["failures"]},
            changes=launcher.changes,
            refused=launcher.refused,
            notes=launcher.notes,
            seconds=self.time.now_ns * 1e-9,
            events=self.time.played,
            streams={key: stream.digest() for key, stream in self.streams.items()},
            on_the_way=sum(self.network.in_transit.values()),
            missed=[disturbance for disturbance in self._pending if disturbance is not None]
            + [Disturbance(0.0, "kill at stop", node, seconds) for node, seconds in self.doomed.items()],
            violations=self.violations,
        )

    def _is_over(self) -> bool:
        return self.launcher.over or (not self.launcher.alive and not self.running())

    # -- disturbances ------------------------------------------------------------------------------------------------

    def _disturb(self, number: int) -> None:
        disturbance = self._pending[number]
        assert disturbance is not None
        _, kind, node, seconds = disturbance
        launcher = self.launcher
        if launcher.over:
            return
        self._pending[number] = None
        if kind == "suspend launcher":
            launcher.suspend(seconds)
        elif kind == "lose launcher":
            launcher.kill()
        elif kind == "interrupt":
            launcher.state.signals.append(2)
        elif kind == "kill at stop":
            self.doomed[node] = seconds
        elif kind == "intercept":
            launcher.request(next(request for request in self.world.requests if request.name == node))
        elif kind == "release":
            launcher.request(Release(node, None))
        elif (process := self.current(node)) is not None:
            self._disturb_process(process, kind, seconds)
        else:
            self._pending[number] = disturbance

    def _disturb_process(self, process: SimulatedProcess, kind: str, seconds: float) -> None:
        if kind == "kill":
            process.kill()
        elif kind == "fill":
            process.fill()
        elif kind in ("suspend", "freeze"):
            process.suspend()
            self.time.after(seconds, process.resume)
        elif kind == "cut" and self.network.cut(process.name, seconds):
            self.time.after(LEASE_NS / S, self._expire, process)
            self.time.after(seconds, self._reconnect, process)

    def _expire(self, process: SimulatedProcess) -> None:
        if process.alive:
            self.token(process, False)

    def _reconnect(self, process: SimulatedProcess) -> None:
        if process.alive:
            self.token(process, True)


def play(world: SimulatedWorld, schedule: Schedule) -> SimulationOutcome:
    """Play a world with a schedule; raises ConfigurationError for one with a node that the world does not have."""
    schedule.check(world)
    return Simulation(world, schedule).play()
