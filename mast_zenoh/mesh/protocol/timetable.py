"""The process steps of a run by frame, for both runtimes; without I/O."""

from __future__ import annotations

from collections.abc import Container, Iterator

from mast_zenoh.config.process_steps import ACTIONS, LEAVING, REALTIME, ProcessStep
from mast_zenoh.config.resolved import DRIVER_ROLE, Resolved
from mast_zenoh.errors import ConfigurationError, nearest


class Timetable:
    """The process steps of a run.

    lockstep: whether every node is waited for, so that none can be paused or cut off

    Raises ConfigurationError for steps that are not possible.
    """

    def __init__(self, resolved: Resolved, *, lockstep: bool) -> None:
        known = list(resolved.nodes)
        self._steps: dict[int, list[ProcessStep]] = {}
        first_action: dict[str, str] = {}
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
                raise ConfigurationError(
                    f"{where}: in lock-step every node is waited for; use {step.action} in real time"
                )
            self._steps.setdefault(max(0, step.frame), []).append(step)
            first_action.setdefault(step.node, step.action)
        #: nodes that start later
        self.absent = frozenset(node for node, action in first_action.items() if action == "start")

    def __bool__(self) -> bool:
        return bool(self._steps)

    def before(self, frame: int, present: Container[str] | None = None) -> Iterator[list[ProcessStep]]:
        """The steps before a frame in groups, those that end a node first; sorted by node.

        present: the running nodes, evaluated for each group: a running node is not started, and one that is not running
                 gets no other step; None: unknown
        """
        for leaving in (True, False):
            group = [step for step in self._steps.get(frame, ()) if (step.action in LEAVING) == leaving]
            if present is not None:
                group = [step for step in group if (step.node in present) != (step.action == "start")]
            if group:
                yield sorted(group, key=lambda step: step.node)
