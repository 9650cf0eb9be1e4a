"""Flattens the metrics of one run into a list of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from mast_zenoh.metrics import CAUSES

NAN = float("nan")
#: The estimator of an adversary's achievements.
ACHIEVED = "achieved"
#: The estimator of what the command centre's defence did.
DEFENCE = "defence"
#: Prefix of metrics of an estimate's consequences for driving.
DRIVING = "driving"
#: s; a trial with a smaller minimum time to collision is critical: van der Horst (1990), see `braking.TimeToCollision`.
CRITICAL_S = 1.5
_MIN_TTC, _CRITICAL = "min_ttc_s", "critical"
#: Metrics without a mean: a trial without a collision course has none, so a mean would skip it.
SELECTIVE = frozenset(f"{DRIVING}.{_MIN_TTC}{suffix}" for suffix in ("", "_iob"))


class Number(NamedTuple):
    """One number of one run.

    owner:     the agent; of an achievement, the adversary, or "all" for all of them; of a defence, "all"; the column
               `who`
    estimator: "local", "picture", "mission", …; ACHIEVED for achievements, DEFENCE for the defence
    metric:    its name; names of nested blocks are joined by dots: "fn_split.attack", "driving.braking_s"
    std:       over frames, NaN for a metric of the whole run; frames: how many, 0 for such a metric
    binary:    whether it is a boolean, as 1 or 0
    """

    owner: str
    estimator: str
    metric: str
    value: float
    std: float = NAN
    frames: int = 0
    binary: bool = False


def ego(metrics: Mapping[str, Any]) -> str:
    """The agent whose estimates are scored: the one named `ego`, else the first of metrics.json."""
    agents = metrics.get("agents", {})
    return "ego" if "ego" in agents else next(iter(agents), "ego")


def scored_frames(metrics: Mapping[str, Any]) -> tuple[int, int]:
    """The first and the last scored frame of metrics.json; (0, -1): none."""
    first, last = metrics.get("scored_frames") or (0, -1)
    return first, last


def numbers(metrics: Mapping[str, Any]) -> Iterator[Number]:
    """The numbers below `agents`, `driving`, `achieved` and `integrity` of metrics.json.

    In file order.
    `null` becomes NaN, true and false become 1 and 0; other values are skipped. Every cause in `causes` gets a number
    of objects per frame, "fp inserted", even if it does not occur. "driving.critical" shows whether the minimum time
    to collision is below CRITICAL_S; every trial has it. These blocks hold no wall-clock times, so all numbers depend
    on scenario and seed alone.
    """
    first, last = scored_frames(metrics)
    frames = last - first + 1
    for agent, estimators in metrics.get("agents", {}).items():
        for estimator, content in estimators.items():
            yield from _flatten(agent, estimator, (), content, frames)
    for agent, estimators in metrics.get("driving", {}).items():
        for estimator, content in estimators.items():
            yield from _flatten(agent, estimator, (DRIVING,), content, frames)
            if _MIN_TTC in content:
                min_ttc = content[_MIN_TTC]
                critical = min_ttc is not None and min_ttc < CRITICAL_S
                yield Number(agent, estimator, f"{DRIVING}.{_CRITICAL}", float(critical), binary=True)
    for adversary, content in metrics.get(ACHIEVED, {}).items():
        yield from _flatten(adversary, ACHIEVED, (), content, frames)
    if metrics.get("integrity"):
        yield from _of_defence(metrics["integrity"])


def _of_defence(integrity: Mapping[str, Any]) -> Iterator[Number]:
    """What a defence did, for all agents together; the delay is NaN if no liar was suspended."""
    liars = [agent for agent in integrity["agents"].values() if agent["lied"]]
    delays = [agent["suspended_after_s"] for agent in liars if agent["suspended_after_s"] is not None]
    withheld = integrity.get("withheld", {})
    for name, value in {
        "lying_agents": len(liars),
        "lying_suspended": len(delays),
        "delay_s": sum(delays) / len(delays) if delays else NAN,
        "honest_suspended": len(integrity["honest_suspended"]),
        "false_alarms": integrity["false_alarms"],
        "withheld_false": withheld.get("false", NAN),
        "withheld_true": withheld.get("true", NAN),
    }.items():
        yield Number("all", DEFENCE, name, float(value))


def _flatten(owner: str, estimator: str, path: tuple[str, ...], content: Any, frames: int) -> Iterator[Number]:
    if isinstance(content, Mapping) and content.keys() == {"mean", "std"}:
        mean, std = (NAN if content[name] is None else float(content[name]) for name in ("mean", "std"))
        yield Number(owner, estimator, ".".join(path), mean, std, frames)
    elif isinstance(content, Mapping) and path[-1:] == ("causes",):
        for outcome, counts in content.items():
            for cause in (*CAUSES, *(each for each in counts if each not in CAUSES)):
                yield Number(owner, estimator, f"{outcome} {cause}", counts.get(cause, 0) / max(frames, 1), NAN, frames)
    elif isinstance(content, Mapping):
        for name, part in content.items():
            yield from _flatten(owner, estimator, (*path, str(name)), part, frames)
    elif isinstance(content, bool):
        yield Number(owner, estimator, ".".join(path), float(content), binary=True)
    elif content is None or isinstance(content, (int, float)):
        yield Number(owner, estimator, ".".join(path), NAN if content is None else float(content))
