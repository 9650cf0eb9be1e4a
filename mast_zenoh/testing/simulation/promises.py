"""What must hold of every run, and the search for a schedule with which it does not."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from functools import lru_cache
from typing import NamedTuple

from mast_zenoh.mesh.control import failures
from mast_zenoh.run_folder.recording.churn import LOST
from mast_zenoh.testing.comparison import first_difference
from mast_zenoh.testing.simulation.simulation import SimulationOutcome, play
from mast_zenoh.testing.simulation.world import Schedule, SimulatedWorld, random_schedule
from mast_zenoh.wiring.model import Wiring

#: Errors with which a run may end; docs/explanation-architecture.md and docs/ref-exit-codes.md describe them.
ENDINGS = frozenset({"StallError", "StartError", "NodeDied", "ImplausibleCounts", "Interrupted"})

#: Returns how an outcome breaks a promise, in words; nothing if it keeps it.
Promise = Callable[[SimulationOutcome], Iterable[str]]

#: Reasons of a stall that need no liar and no slow process: a node that was to start, or all nodes, have been killed.
_EXCUSES = ("not done before frame", "no other node is on the mesh")

#: Results of a node that counts what it handles: messages, and those that came twice, never, or after later ones.
_COUNTS = frozenset({"handled", "twice", "missing", "disordered"})


class Counterexample(NamedTuple):
    """A schedule with which promises are broken, and which."""

    schedule: Schedule
    violations: tuple[str, ...]

    def __str__(self) -> str:
        return "\n".join(["broken:", *self.violations, "with this schedule:", str(self.schedule), repr(self.schedule)])


@lru_cache(maxsize=64)
def undisturbed(world: SimulatedWorld) -> SimulationOutcome:
    """The outcome of a world in which nothing happens but its scenario."""
    return play(world, Schedule(0, calm=True))


def check(world: SimulatedWorld, schedule: Schedule, promise: Promise = lambda outcome: ()) -> list[str]:
    """Play a world with a schedule; returns the broken promises, in words.

    promise: one of your own: returns how an outcome breaks it
    """
    outcome, reference = play(world, schedule), undisturbed(world)
    broken = [*outcome.violations, *promise(outcome)]
    if (error := outcome.error.partition(":")[0]) and error not in ENDINGS:
        broken.append(f"the run ended with {outcome.error}")
    if outcome.ended and not outcome.error and not outcome.launcher_lost:
        nodes = world.resolved.nodes
        needed = [name for name in outcome.lost if name in nodes and nodes[name].on_exit == "fail"]
        broken += [f"{name} {outcome.lost[name]}, and the run ended without an error" for name in needed]
    broken += [*_failures(outcome, reference), *_wrong_endings(world, schedule, outcome, reference)]
    if world.resolved.mode != "lockstep":
        return broken + _broken_in_real_time(schedule, outcome, has_steps=bool(world.resolved.steps))
    if outcome.claims_to_be_exact(reference):
        overhearers = Wiring.from_json(world.resolved.wiring).overhearers if outcome.changes else ()
        broken += _differences(outcome, reference, {end.node for end in overhearers})
    elif schedule.harmless:
        broken.append(f"nothing was to harm the run, which ended with {_complaints(outcome)}")
    elif (
        outcome.error.startswith(("ImplausibleCounts", "StallError"))
        and not any(excuse in outcome.error for excuse in _EXCUSES)
        and not schedule.freezes
    ):
        broken.append(f"no process lied or was too slow, but the run ended with {outcome.error}")
    return broken


def _wrong_endings(
    world: SimulatedWorld, schedule: Schedule, outcome: SimulationOutcome, reference: SimulationOutcome
) -> Iterator[str]:
    """How the end of a run, or the losses that it tells of, contradict what happened in it."""
    kind, _, text = outcome.error.partition(": ")
    dead = text.partition(" ")[0]
    if kind == "NodeDied" and (spec := world.resolved.nodes.get(dead)) is not None and spec.on_exit != "fail":
        yield f"on_exit of {dead} is {spec.on_exit}, but the run ended with {outcome.error}"
    interrupted = [disturbance.kind for disturbance in schedule.disturbances] == ["interrupt"] and outcome.frames > 0
    if interrupted and not world.resolved.steps:
        for name in sorted(reference.results.keys() - outcome.results.keys()):
            yield f"a stop signal has cost the results of {name}"
    if world.resolved.mode == "lockstep" and not outcome.error:
        lost = {event["node"] for event in outcome.churn if event["what"] == LOST}
        # An inserted node may be ended because its insertion was given up.
        for name in sorted((lost & world.resolved.nodes.keys()) - outcome.died):
            yield f"{name} is told as lost, but no process of it has died"


def _failures(outcome: SimulationOutcome, reference: SimulationOutcome) -> list[str]:
    """The handlers that fail in this run alone."""
    known = {(name, entry["handler"]) for name, entries in reference.failures.items() for entry in entries}
    return failures.lines(
        {
            name: [entry for entry in entries if (name, entry["handler"]) not in known]
            for name, entries in outcome.failures.items()
        }
    )


def _differences(outcome: SimulationOutcome, reference: SimulationOutcome, ignored: Container[str]) -> list[str]:
    """How a run differs from the undisturbed one although its record does not say so; ignored: nodes."""
    if outcome.frames != reference.frames:
        return [f"it played {outcome.frames} frames, not {reference.frames}, and its record does not say so"]
    lines = []
    for name, expected in sorted(reference.results.items()):
        if name not in outcome.results:
            lines.append(f"it has no results of {name}, and its record does not say so")
        elif name not in ignored and (difference := first_difference(outcome.results[name], expected, name)):
            lines.append(f"results differ from the undisturbed run, and the record does not say so: {difference}")
    for key, stream in sorted(reference.streams.items()):
        if outcome.streams.get(key) != stream and not (outcome.changes and "@tap" in key):
            lines.append(f"messages on {key} differ from the undisturbed run, and the record does not say so")
    return lines


def _broken_in_real_time(schedule: Schedule, outcome: SimulationOutcome, *, has_steps: bool) -> list[str]:
    """A run without any fault loses and doubles nothing, whatever is inserted into it and released.

    has_steps: whether the scenario ends nodes, which then miss messages
    """
    kinds = {disturbance.kind for disturbance in schedule.disturbances}
    if kinds <= {"intercept", "release"} and not schedule.loss:
        if outcome.error or outcome.lost or outcome.churn:
            return [f"nothing was to harm the run, which ended with {_complaints(outcome)}"]
        wrong = {"twice"} | ({"missing"} if not (outcome.on_the_way or has_steps) else set())
        wrong |= {"disordered"} if schedule.calm else set()  # else one way may be faster than another
        return [
            f"{name} handled {counts['handled']} messages: "
            + ", ".join(f"{counts[kind]} {kind}" for kind in sorted(wrong))
            for name, counts in outcome.results.items()
            if counts.keys() >= _COUNTS and any(counts[kind] for kind in wrong)
        ]
    return []


def _complaints(outcome: SimulationOutcome) -> str:
    rejected = {name: counts for name, counts in outcome.rejected.items() if counts}
    parts = [
        outcome.error,
        *(f"{name} {how}" for name, how in outcome.lost.items()),
        *map(str, outcome.churn),
        str(rejected) if rejected else "",
    ]
    return "; ".join(filter(None, parts)) or "no end"


def find(world: SimulatedWorld, seeds: Iterable[int], promise: Promise = lambda outcome: ()) -> Counterexample | None:
    """The first of these seeds' schedules with which promises of a world are broken; None for none.

    promise: see `check`
    """
    for seed in seeds:
        schedule = random_schedule(seed, world)
        if violations := check(world, schedule, promise):
            return Counterexample(schedule, tuple(violations))
    return None


def simplest(world: SimulatedWorld, broken: Counterexample, promise: Promise = lambda outcome: ()) -> Counterexample:
    """A schedule without the disturbances that are not needed to break promises; promise: see `check`."""
    while True:
        for schedule in broken.schedule.simpler():
            if violations := check(world, schedule, promise):
                broken = Counterexample(schedule, tuple(violations))
                break
        else:
            return broken


def explore(world: SimulatedWorld, seeds: Iterable[int], promise: Promise = lambda outcome: ()) -> None:
    """Raise AssertionError if the schedule of some seed breaks a promise, with the simplest one found.

    A world must keep its promises without any disturbance, too. promise: see `check`
    """
    reference = undisturbed(world)
    problems = [reference.error, *reference.violations, *failures.lines(reference.failures)]
    if any(problems):
        raise AssertionError(f"without any disturbance: {'; '.join(filter(None, problems))}")
    if (broken := find(world, seeds, promise)) is not None:
        raise AssertionError(str(simplest(world, broken, promise)))
