"""What is done to processes before which frame, as both runtimes carry it out; without I/O."""

from __future__ import annotations

from collections.abc import Container, Iterator

from mast_zenoh.config.process_steps import ACTIONS, REALTIME, ProcessStep
from mast_zenoh.config.resolved import DRIVER_ROLE, Resolved
from mast_zenoh.errors import ConfigurationError, nearest

#: After these a node is not there any more.
LEAVING = ("kill", "leave")


class Timetable:
    """The process steps of a run.

    lockstep: whether everybody is waited for: then nobody can be paused or cut off

    Raises ConfigurationError for what cannot be done.
    """

    def __init__(self, resolved: Resolved, *, lockstep: bool) -> None:
        known = list(resolved.nodes)
        self._steps: dict[int, list[ProcessStep]] = {}
        first: dict[str, str] = {}
        for step in sorted(resolved.steps, key=lambda step: step.frame):
            where = f"steps: frame {step.frame}: {step.action} {step.node}"
            if step.node not in known:
                raise ConfigurationError(f"{where}: there is no such node{nearest(step.node, known)}")
            if step.action not in ACTIONS:
                raise ConfigurationError(
                    f"{where}: expected one of {', '.join(ACTIONS)}{nearest(step.action, ACTIONS)}"
                )
            if resolved.nodes[step.node].role == DRIVER_ROLE:
                raise ConfigurationError(f"{where}: the run ends without the node that drives the scene")
            if lockstep and step.action in REALTIME:
                raise ConfigurationError(f"{where}: in lock-step everybody is waited for; {step.action} in real time")
            self._steps.setdefault(max(0, step.frame), []).append(step)
            first.setdefault(step.node, step.action)
        #: those who are not there at the beginning
        self.absent = frozenset(node for node, action in first.items() if action == "start")

    def __bool__(self) -> bool:
        return bool(self._steps)

    def before(self, frame: int, present: Container[str] | None = None) -> Iterator[list[ProcessStep]]:
        """What is to be done before a frame, group by group: first who leaves, then the others; by name.

        present: those who are up, looked at anew for each group: who is up is not started, who is not does not leave;
                 None: not known
        """
        for leaving in (True, False):
            group = [step for step in self._steps.get(frame, ()) if (step.action in LEAVING) == leaving]
            if present is not None:
                group = [step for step in group if (step.node in present) != (step.action == "start")]
            if group:
                yield sorted(group, key=lambda step: step.node)
