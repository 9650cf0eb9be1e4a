"""What must hold of every run, and the search for a schedule with which it does not."""

from __future__ import annotations

from collections.abc import Iterable
from functools import lru_cache
from typing import NamedTuple

from mast_zenoh.control import failures, results
from mast_zenoh.testing.simulation.schedule import Schedule, random_schedule
from mast_zenoh.testing.simulation.simulation import Outcome, play
from mast_zenoh.testing.simulation.world import World

#: Errors with which a run may end; docs/endings.md and docs/exit_codes.md describe them.
ENDINGS = frozenset({"StallError", "StartError", "NodeDied", "ImplausibleCounts", "Interrupted"})

_NOT_DONE = "not done before frame"  # a node that was to start has been killed before it was there


class Broken(NamedTuple):
    """A schedule with which promises are broken, and which."""

    schedule: Schedule
    violations: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(["broken:", *self.violations, "with this schedule:", str(self.schedule), repr(self.schedule)])


@lru_cache(maxsize=64)
def undisturbed(world: World) -> Outcome:
    """The outcome of a world in which nothing happens but its scenario."""
    return play(world, Schedule(0, calm=True))


def check(world: World, schedule: Schedule) -> list[str]:
    """Play a world with a schedule; returns the broken promises, in words."""
    outcome = play(world, schedule)
    broken = list(outcome.violations)
    if (error := outcome.error.partition(":")[0]) and error not in ENDINGS:
        broken.append(f"the run ended with {outcome.error}")
    if outcome.ended and not outcome.error and not outcome.launcher_lost:
        nodes = world.resolved.nodes
        needed = [name for name in outcome.lost if name in nodes and nodes[name].on_exit == "fail"]
        broken += [f"{name} {outcome.lost[name]}, and the run ended without an error" for name in needed]
    reference = undisturbed(world)
    broken += _failures(outcome, reference)
    if world.resolved.mode != "lockstep":
        return broken + _broken_in_real_time(schedule, outcome)
    if outcome.claims_to_be_exact:
        broken += _differences(outcome, reference)
    elif schedule.harmless:
        broken.append(f"nothing was to harm the run, which ended with {_complaints(outcome)}")
    elif (
        outcome.error.startswith(("ImplausibleCounts", "StallError"))
        and _NOT_DONE not in outcome.error
        and not schedule.freezes
    ):
        broken.append(f"no process lied or was too slow, but the run ended with {outcome.error}")
    return broken


def _failures(outcome: Outcome, reference: Outcome) -> list[str]:
    """The handlers that fail in this run alone."""
    known = {(name, entry["handler"]) for name, entries in reference.failures.items() for entry in entries}
    return failures.lines(
        {
            name: [entry for entry in entries if (name, entry["handler"]) not in known]
            for name, entries in outcome.failures.items()
        }
    )


def _differences(outcome: Outcome, reference: Outcome) -> list[str]:
    if outcome.frames != reference.frames:
        return [f"it played {outcome.frames} frames, not {reference.frames}, and does not say so"]
    lines = []
    for name, expected in sorted(reference.results.items()):
        if name not in outcome.results:
            lines.append(f"it has no results of {name}, and does not say so")
        elif results.pack(outcome.results[name]) != results.pack(expected):
            actual = str(outcome.results[name])
            lines.append(f"it does not say that the results of {name} differ: {actual:.400}, not {expected!s:.400}")
    for key, stream in sorted(reference.streams.items()):
        if outcome.streams.get(key) != stream:
            lines.append(f"it does not say that the messages on {key} differ from those of the undisturbed run")
    return lines


def _broken_in_real_time(schedule: Schedule, outcome: Outcome) -> list[str]:
    """A run without any fault loses and doubles nothing, whatever is inserted into it and released."""
    kinds = {disturbance.kind for disturbance in schedule.disturbances}
    if kinds <= {"intercept", "release"} and not schedule.loss:
        if outcome.error or outcome.lost or outcome.churn:
            return [f"nothing was to harm the run, which ended with {_complaints(outcome)}"]
        wrong = {"twice"} | ({"missing"} if not outcome.on_the_way else set())
        wrong |= {"disordered"} if schedule.calm else set()  # else one way may be faster than another
        return [
            f"{name} handled {each['handled']} messages: {', '.join(f'{each[kind]} {kind}' for kind in sorted(wrong))}"
            for name, each in outcome.results.items()
            if any(each.get(kind) for kind in wrong)
        ]
    return []


def _complaints(outcome: Outcome) -> str:
    rejected = {name: counts for name, counts in outcome.rejected.items() if counts}
    parts = [
        outcome.error,
        *(f"{name} {how}" for name, how in outcome.lost.items()),
        *map(str, outcome.churn),
        str(rejected) if rejected else "",
    ]
    return "; ".join(filter(None, parts)) or "no end"


def find(world: World, seeds: Iterable[int]) -> Broken | None:
    """The first of these seeds' schedules with which promises of a world are broken; None for none."""
    for seed in seeds:
        schedule = random_schedule(seed, world)
        if violations := check(world, schedule):
            return Broken(schedule, tuple(violations))
    return None


def simplest(world: World, broken: Broken) -> Broken:
    """A schedule with as little as possible with which promises are still broken."""
    while True:
        for schedule in broken.schedule.simpler():
            if violations := check(world, schedule):
                broken = Broken(schedule, tuple(violations))
                break
        else:
            return broken


def explore(world: World, seeds: Iterable[int]) -> None:
    """Raise AssertionError with the simplest schedule found if some seed's schedule breaks a promise."""
    if (broken := find(world, seeds)) is not None:
        raise AssertionError(str(simplest(world, broken)))
