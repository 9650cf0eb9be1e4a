"""Random lists of faults for a scenario, all of which end before the run does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from mast_zenoh.errors import nearest
from mast_zenoh.streams import stream

_STEP_S = 0.05  # times are multiples of it
_SHORTEST_S = 0.2


def random_schedule(
    seed: int,
    duration_s: float,
    agents: Sequence[str],
    *,
    servers: Sequence[str] = (),
    settle_s: float = 2.0,
    max_faults: int = 5,
    kinds: Sequence[str] | None = None,
) -> list[dict[str, Any]]:
    """A random list of faults, as for a scenario's `faults`.

    Equal arguments give equal lists.

    duration_s: of the run, s of scene time;  settle_s: fault-free time at the end, s
    agents:     possible targets
    servers:    other targets to kill, restart or cut off: "broker", "command_center"
    kinds:      types of faults to draw from; None: all

    The list is consistent: it never kills a stopped node. Raises ValueError if there is no time for a fault.
    """
    if kinds is None:
        kinds = tuple(_PARAMETERS)
    for kind in kinds:
        if kind not in _PARAMETERS:
            raise ValueError(f"kinds: no fault {kind!r}{nearest(str(kind), _PARAMETERS)}")
    if not agents or not kinds or max_faults < 1:
        raise ValueError("expected at least one agent, one kind and one fault")
    ticks = int((duration_s - settle_s) / _STEP_S + 1e-9)
    shortest = round(_SHORTEST_S / _STEP_S)
    if ticks < shortest + 1:
        raise ValueError(f"duration_s: found {duration_s}, expected {settle_s + _SHORTEST_S + _STEP_S:g} or more")
    rng = stream(seed, "faults", "schedule")
    busy: dict[str, list[tuple[int, int]]] = {}
    faults: list[dict[str, Any]] = []
    for _ in range(int(rng.integers(1, max_faults + 1))):
        kind = str(rng.choice(list(kinds)))
        start = int(rng.integers(1, ticks - shortest + 1))
        end = int(rng.integers(start + shortest, ticks + 1))
        fault: dict[str, Any] = {"type": kind, "at": _seconds(start)}
        if kind in _PROCESS:
            node = str(rng.choice([*agents, *(servers if kind != "Join" else ())]))
            taken = busy.setdefault(node, [])
            # A joining node is absent from the start; a frame may be longer than a tick, so leave a margin around each.
            span = (0 if kind == "Join" else start - _MARGIN, end + _MARGIN)
            if any(span[0] < last and first < span[1] for first, last in taken):
                continue
            taken.append(span)
            fault["node"] = node
            fault |= {"Join": {"at": _seconds(end)}, "Pause": {"until": _seconds(end)}}.get(kind, {})
            if kind in _WAIT:
                fault[_WAIT[kind]] = _seconds(end - start)
        else:
            fault |= {"until": _seconds(end), **_targets(rng, agents, servers), **_PARAMETERS[kind](rng)}
        faults.append(fault)
    return sorted(faults, key=lambda fault: fault["at"])


_MARGIN = 5  # ticks between two faults of one process
_WAIT = {"Kill": "restart_after", "Leave": "return_after", "Restart": "down_s"}
_PROCESS = (*_WAIT, "Join", "Pause")

_Sampler = Callable[[np.random.Generator], dict[str, Any]]


def _uniform(low: float, high: float, name: str) -> _Sampler:
    return lambda rng: {name: round(float(rng.uniform(low, high)), 3)}


#: Random parameters by type of fault.
_PARAMETERS: dict[str, _Sampler] = {
    **dict.fromkeys((*_PROCESS, "Partition"), lambda rng: {}),
    "Loss": _uniform(0.05, 0.9, "probability"),
    "BurstLoss": lambda rng: {**_uniform(0.05, 0.5, "good_to_bad")(rng), **_uniform(0.1, 0.8, "bad_to_good")(rng)},
    "Delay": lambda rng: {**_uniform(0.0, 0.4, "mean_s")(rng), **_uniform(0.0, 0.1, "jitter_s")(rng)},
    "SlowNode": _uniform(0.05, 0.5, "delay_s"),
    "BandwidthLimit": lambda rng: {"bits_per_s": round(10.0 ** float(rng.uniform(5.3, 6.5)))},
    "Corrupt": lambda rng: {**_uniform(0.05, 0.9, "probability")(rng), "flips": int(rng.integers(1, 20))},
    "Duplicate": lambda rng: {**_uniform(0.1, 1.0, "probability")(rng), "copies": int(rng.integers(1, 4))},
    "Flood": lambda rng: {"copies": int(rng.integers(1, 9))},
    "Reorder": lambda rng: {**_uniform(0.1, 0.9, "probability")(rng), **_uniform(0.05, 0.3, "by_s")(rng)},
}


def _seconds(ticks: int) -> float:
    return round(ticks * _STEP_S, 3)


def _targets(rng: np.random.Generator, agents: Sequence[str], servers: Sequence[str]) -> dict[str, Any]:
    """Draw targets: agents by name or by a word, or a server."""
    way = int(rng.integers(4))
    if way == 0 and servers:
        return {"node": str(rng.choice(list(servers)))}
    if way == 1:
        return {"nodes": str(rng.choice(["one", "minority", "majority", "agent"]))}
    count = int(rng.integers(1, len(agents) + 1))
    return {"nodes": [agents[i] for i in sorted(rng.permutation(len(agents))[:count])]}
