"""Every number in the metrics of one run as a flat list, whatever estimators and metrics there are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

from mast_zenoh.metrics import CAUSES

NAN = float("nan")
#: Stands in the place of an estimator in what an adversary achieved.
ACHIEVED = "achieved"
#: Stands before the names of what an estimate would mean for driving.
DRIVING = "driving"
#: s; a trial whose least time to collision is below is critical: van der Horst (1990), see `braking.TimeToCollision`.
CRITICAL_S = 1.5
_LEAST_TTC, _CRITICAL = "min_ttc_s", "critical"
#: Numbers of which no mean is taken: a trial without a collision course has none, so a mean is over the other trials.
SELECTIVE = frozenset(f"{DRIVING}.{_LEAST_TTC}{suffix}" for suffix in ("", "_iob"))


class Number(NamedTuple):
    """One number of one run.

    who:       the agent, or what an achievement is that of: an adversary, or "all"
    estimator: "local", "picture", "mission", …; ACHIEVED for achievements
    metric:    its name; of nested blocks the names joined by dots: "fn_split.attack", "driving.braking_s"
    std:       over frames, NaN where the metric is of the whole run; frames: how many, 0 for those
    binary:    whether it is a yes or no, as 1 or 0
    """

    who: str
    estimator: str
    metric: str
    value: float
    std: float = NAN
    frames: int = 0
    binary: bool = False


def numbers(metrics: Mapping[str, Any]) -> Iterator[Number]:
    """The numbers of `agents`, `driving` and `achieved` in what metrics.json holds, in its order.

    `null` becomes NaN, true and false become 1 and 0, and what is not a number is left out. Of `causes` every cause has
    a number of objects per frame, "fp inserted", also where it does not occur. Of driving there is also whether the
    least time to collision is below CRITICAL_S, "driving.critical", which every trial has. Numbers of the wall clock
    are in none of these blocks, so all depend on scenario and seed alone.
    """
    first, last = metrics.get("scored_frames") or (0, -1)
    frames = last - first + 1
    for agent, estimators in metrics.get("agents", {}).items():
        for estimator, content in estimators.items():
            yield from _within(agent, estimator, (), content, frames)
    for agent, estimators in metrics.get("driving", {}).items():
        for estimator, content in estimators.items():
            yield from _within(agent, estimator, (DRIVING,), content, frames)
            if _LEAST_TTC in content:
                least = content[_LEAST_TTC]
                critical = least is not None and least < CRITICAL_S
                yield Number(agent, estimator, f"{DRIVING}.{_CRITICAL}", float(critical), binary=True)
    for adversary, content in metrics.get(ACHIEVED, {}).items():
        yield from _within(adversary, ACHIEVED, (), content, frames)


def _within(who: str, estimator: str, path: tuple[str, ...], content: Any, frames: int) -> Iterator[Number]:
    if isinstance(content, Mapping) and content.keys() == {"mean", "std"}:
        mean, std = (NAN if content[name] is None else float(content[name]) for name in ("mean", "std"))
        yield Number(who, estimator, ".".join(path), mean, std, frames)
    elif isinstance(content, Mapping) and path[-1:] == ("causes",):
        for what, counts in content.items():
            for cause in (*CAUSES, *(each for each in counts if each not in CAUSES)):
                yield Number(who, estimator, f"{what} {cause}", counts.get(cause, 0) / max(frames, 1), NAN, frames)
    elif isinstance(content, Mapping):
        for name, part in content.items():
            yield from _within(who, estimator, (*path, str(name)), part, frames)
    elif isinstance(content, bool):
        yield Number(who, estimator, ".".join(path), float(content), binary=True)
    elif content is None or isinstance(content, (int, float)):
        yield Number(who, estimator, ".".join(path), NAN if content is None else float(content))
