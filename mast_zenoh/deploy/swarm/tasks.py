"""Tasks of a stack as listed by Docker: each is one attempt to run a node."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import NamedTuple

from mast_zenoh.deploy.docker import docker
from mast_zenoh.errors import EngineError

_FIELDS = ("ID", "Name", "Node", "DesiredState", "CurrentState", "Error")
_NOTHING = "nothing found in stack"  # only Docker's error text distinguishes this failure
_MISSING = "No such image"
_CODE = re.compile(r"non-zero exit \((\d+)\)")

#: A task in one of these states runs no more, and will not run.
_OVER = frozenset({"complete", "failed", "rejected", "shutdown", "orphaned"})

#: Exit codes for a task that could not be started (as from `docker run`), and for one that was asked to end.
_NOT_STARTED = 125
ASKED_TO_END = -15


class Task(NamedTuple):
    """One attempt to run a node.

    machine: its name in the swarm, "" if not placed yet;  state: one word, such as "running"
    wanted:  the desired state;  error: Docker's reason for a failure or for waiting
    """

    id: str
    node: str
    machine: str
    wanted: str
    state: str
    error: str

    @property
    def exit(self) -> int | None:
        """Exit code of its process, negative for a signal; None if it has not ended."""
        if self.state not in _OVER:
            return None
        if self.state == "complete":
            return 0
        if found := _CODE.search(self.error):
            code = int(found[1])
            return 128 - code if code > 128 else code
        return ASKED_TO_END if self.state == "shutdown" else _NOT_STARTED

    @property
    def waits(self) -> bool:
        """Whether it waits for a machine, for a reason that Docker names."""
        return self.state in ("new", "pending") and bool(self.error)

    @property
    def refused(self) -> str:
        """Why its machine has not started it; empty if it has."""
        if self.exit != _NOT_STARTED or _CODE.search(self.error):
            return ""
        missing = (
            "; no registry has it: `docker save` it here, `docker load` it there" if _MISSING in self.error else ""
        )
        return f"{self.machine}: {self.error or self.state}{missing}"


def of(stack: str) -> dict[str, list[Task]]:
    """The tasks of a stack by node, newest first; none without it. Raises EngineError."""
    form = "\t".join(f"{{{{.{field}}}}}" for field in _FIELDS)
    try:
        return parse(stack, docker("stack", "ps", stack, "--no-trunc", "--format", form).splitlines())
    except EngineError as error:
        if _NOTHING in str(error):
            return {}
        raise


def parse(stack: str, lines: Iterable[str]) -> dict[str, list[Task]]:
    """Parse the output of `docker stack ps`: tasks by node, the newest first."""
    tasks: dict[str, list[Task]] = {}
    for line in lines:
        fields = line.split("\t")
        if len(fields) < len(_FIELDS):
            continue
        identity, name, machine, wanted, state, error = fields[: len(_FIELDS)]
        node = name.removeprefix("\\_ ").removeprefix(f"{stack}_").rpartition(".")[0]
        task = Task(identity, node, machine, wanted.lower(), state.partition(" ")[0].lower(), error.strip('"'))
        tasks.setdefault(node, []).append(task)
    return tasks
