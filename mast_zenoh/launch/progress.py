"""Whether nodes that are to finish make progress, and for how long that is enough."""

from __future__ import annotations

from collections.abc import Callable

from mast_zenoh.launch.supervisor import Child

COMPUTE_LIMIT_S = 600.0  #: for which a node may compute without data, as its supervisor measures it
UNMEASURED_LIMIT_S = 120.0  #: the same where nothing measures it
END_LIMIT_S = 3600.0  #: for everything
#: Share of a processor that counts as computing. One that waits uses a third of it, for the requests to stop; one that
#: computes with the niceness of a listener gets four times as much beside two busy processes on its processor.
_COMPUTING = 0.0125


class Progress:
    """Whether nodes make progress that have been asked to finish: by data, and by processor time as measured.

    now_s: a monotonic clock, s;  last_data_s: when the last data of a node arrived, s
    """

    def __init__(self, now_s: Callable[[], float], last_data_s: Callable[[str], float]) -> None:
        self._now_s = now_s
        self._last_data_s = last_data_s
        # By node: processor time at a time, s, and when it was last seen to compute.
        self._computed: dict[str, tuple[float, float, float]] = {}

    def problem(self, child: Child, since: float, grace: float, *, interrupted: bool) -> str:
        """Why a node is not waited for any longer; empty: it has made progress lately.

        since: when it was asked to finish, s;  grace: for which it may make none, s
        """
        now, cpu_s = self._now_s(), child.cpu_s
        data_s = max(since, self._last_data_s(child.name))
        computed_s = data_s
        if cpu_s is not None:
            before_s, at_s, computed_s = self._computed.get(child.name, (cpu_s, since, since))
            if cpu_s < before_s or cpu_s - before_s >= _COMPUTING * grace:  # less: it is another process
                before_s, at_s, computed_s = cpu_s, now, now
            elif now - at_s > grace:
                before_s, at_s = cpu_s, now
            self._computed[child.name] = before_s, at_s, computed_s
        if interrupted:
            return f"has not finished within {grace:.0f} s" if now - data_s > grace else ""
        if now - since > END_LIMIT_S:
            return f"has not finished within {END_LIMIT_S:.0f} s"
        if cpu_s is None:
            limit = max(grace, UNMEASURED_LIMIT_S)
            return f"has not finished within {limit:.0f} s" if now - data_s > limit else ""
        if now - max(data_s, computed_s) > grace:
            return f"has not finished within {grace:.0f} s" + (" without progress" if computed_s > since else "")
        limit = max(grace, COMPUTE_LIMIT_S)
        return f"has computed for {limit:.0f} s and handed in nothing" if now - data_s > limit else ""
