"""Receives the driver's requests for process steps, and checks which steps are possible."""

from __future__ import annotations

import queue

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import flow
from mast_zenoh.control.invalid import InvalidMessages
from mast_zenoh.control.signatures import Signatures
from mast_zenoh.errors import BackendError, MessageError
from mast_zenoh.launch.protocol.steps import Steps

MAX_WAITING = 1000  #: requests of the driver in the queue


def check(resolved: Resolved, where: str, *, unplugs: bool) -> None:
    """Raise BackendError for steps that are impossible where the nodes live.

    where: in words; unplugs: whether nodes can be disconnected from their networks there
    """
    for step in resolved.steps:
        if step.action == "disconnect" and not unplugs:
            raise BackendError(
                f"Unplug of {step.node!r} (before frame {step.frame}): only the containers of engine compose can be "
                f"disconnected from their networks (mast deploy up --engine compose), found {where}; use Partition, or "
                "on this machine `hosts` with HostPartition"
            )


class StepRequests:
    """Queue of the driver's requests for process steps, decoded on arrival."""

    def __init__(self, steps: Steps, signatures: Signatures, invalid: InvalidMessages) -> None:
        self._steps = steps
        self._signatures = signatures
        self._invalid = invalid
        # Not a SimpleQueue: its `get` never returns if a signal is still being handled when the timeout expires.
        self._waiting: queue.Queue[flow.Act] = queue.Queue(MAX_WAITING)

    def take(self, payload: bytes) -> None:
        """Queue a request, in Zenoh's thread; refuse a malformed or unsigned one."""
        try:
            self._waiting.put_nowait(self._signatures.open("act", payload, flow.decode_act))
        except MessageError as error:
            self._invalid.note("act", error)
        except queue.Full:
            self._invalid.note("act", f"more than {MAX_WAITING} requests are waiting")

    def serve(self, timeout_s: float, *, stopping: bool = False) -> None:
        """Wait up to timeout_s for a request; carry it out unless the run is stopping."""
        try:
            request = self._waiting.get(timeout=timeout_s)
        except queue.Empty:
            return
        if not stopping:
            try:
                self._steps.carry_out(*request)
            except MessageError as error:
                self._invalid.note("act", error)
