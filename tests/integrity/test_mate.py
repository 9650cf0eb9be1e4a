"""`Mate` gives the values of the published method.

The expected values are computed by hand from the formulas of cpsl-research/lib-avstack-trust.
"""

import math

import numpy as np
import pytest
from integrity_batches import STEP_NS, Track, batch, view

from mast_zenoh.integrity import Mate

#: Sensors 20 m from the origin.
VIEWS = {"a": view((-20.0, 0.0)), "b": view((20.0, 0.0)), "c": view((0.0, 20.0)), "d": view((0.0, -20.0))}
AGENTS = tuple(VIEWS)


def test_an_object_that_several_agents_do_not_report_is_withheld() -> None:
    mate = Mate()
    for frame in range(15):
        assessment = mate.assess(batch([("a", 0, (0.0, 0.0))], AGENTS, VIEWS, frame=frame))
    assert assessment.objects.trust[0] < 0.4
    assert assessment.objects.withheld.tolist() == [True]
    assert assessment.objects.contradicting.tolist() == [3]
    assert assessment.agents.mean[0] < 0.2 < 0.5 < assessment.agents.mean[1:].min()


def test_an_object_that_only_one_agent_could_see_is_neither_trusted_nor_doubted() -> None:
    mate = Mate()
    trust = {
        mate.assess(batch([("a", 0, (0.0, 0.0))], ("a",), {"a": VIEWS["a"]}, frame=frame)).objects.trust[0]
        for frame in range(15)
    }
    assert trust == {0.5}


class ByHand:
    """The formulas of the original, one piece of evidence after the other, for objects and agents by name."""

    def __init__(self) -> None:
        self.agents: dict[str, list[float]] = {}
        self.objects: dict[int, list[float]] = {}
        self.updates: dict[int, int] = {}
        self.in_view: dict[tuple[str, int], int] = {}

    def step(self, reports: dict[str, set[int]], viewers: dict[int, set[str]], distance: dict[str, float]) -> None:
        """One batch, 0.1 s after the last, in which all objects are reported by someone.

        reports: objects of each agent; viewers: agents that have each object in view; distance: m, of each agent from
        all objects
        """
        about_agents: list[tuple[str, float, float]] = []
        about_objects: list[tuple[int, float, float]] = []
        for name in reports:
            self.agents.setdefault(name, [0.5, 0.5])
        for each in viewers:
            self.objects.setdefault(each, [0.5, 0.5])
            self.updates[each] = self.updates.get(each, 0) + 1
        for name, reported in reports.items():
            for each, seen_by in viewers.items():
                seen = name in seen_by
                frames = self.in_view[name, each] = self.in_view.get((name, each), 0) + 1 if seen else 0
                alpha, beta = self.objects[each]
                value = alpha / (alpha + beta)
                deviation = math.sqrt(alpha * beta / ((alpha + beta) ** 2 * (alpha + beta + 1.0)))
                trusted = self.agents[name][0] / sum(self.agents[name])
                if each in reported:
                    about_agents.append((name, value, min(max(1.0 - 2.0 * deviation, 0.0001), 0.9999)))
                    about_objects.append((each, 1.0, trusted))
                elif seen and distance[name] <= 70.0:
                    if distance[name] < 30.0:
                        weight = 1.0 if frames > 2 else 0.25
                    else:
                        weight = min(max((frames - 3) / 3, 0.0), 1.0)
                    weight *= (1.0 if distance[name] < 60.0 else 0.5) * (self.updates[each] >= 2)
                    confidence = min(max(weight * (1.0 - 2.0 * deviation), 0.0001), 0.9999)
                    about_agents.append((name, 1.0 - value, confidence))
                    about_objects.append((each, 0.0, weight * trusted))
        for trust in (*self.agents.values(), *self.objects.values()):
            trust[:] = [0.9 * part + 0.1 * 0.5 for part in trust]
        for name, value, confidence in about_agents:
            self.update(self.agents[name], value, confidence, 6.0 if value < 0.3 else 1.0)
        for each, value, confidence in about_objects:
            if sum(other == each for other, _, _ in about_objects) > 1:
                self.update(self.objects[each], value, confidence, 1.0)

    @staticmethod
    def update(trust: list[float], value: float, confidence: float, n: float) -> None:
        trust[0] += n / (n + 1.0) * confidence * value
        trust[1] += n * n / (n + 1.0) * confidence * (1.0 - value)


def test_sixty_batches_give_the_values_of_the_formulas() -> None:
    random = np.random.default_rng(5)
    mate, by_hand = Mate(), ByHand()
    # All objects are at the origin's distance of each agent, up to a few centimetres on which nothing depends.
    radius = dict(zip(AGENTS, (20.0, 40.0, 55.0, 65.0), strict=True))
    angle = dict(zip(AGENTS, (0.0, 1.5, 3.0, 4.5), strict=True))
    place = {name: (radius[name] * math.cos(angle[name]), radius[name] * math.sin(angle[name])) for name in AGENTS}
    objects = {0: (0.0, -4.5), 1: (0.0, 0.0), 2: (0.0, 4.5)}
    for frame in range(60):
        reports: dict[str, set[int]] = {
            name: {each for each in objects if random.uniform() < (0.9 if each < 2 else 0.1)} for name in AGENTS
        }
        for each in objects:
            reports["a"] |= {each} if not any(each in seen for seen in reports.values()) else set()
        tracks: list[Track] = [(name, each, objects[each]) for name in AGENTS for each in sorted(reports[name])]
        views = {name: view(place[name], max_range=100.0) for name in AGENTS if name != "d" or frame % 10 < 7}
        found = mate.assess(batch(tracks, AGENTS, views, frame=frame))
        by_hand.step(reports, {each: set(views) for each in objects}, radius)
        expected = [alpha / (alpha + beta) for alpha, beta in (by_hand.agents[name] for name in AGENTS)]
        assert found.agents.mean == pytest.approx(expected, rel=1e-9), frame
        expected = [alpha / (alpha + beta) for alpha, beta in (by_hand.objects[each] for each in objects)]
        assert found.objects.trust == pytest.approx(expected, rel=1e-9), frame
    assert found.objects.trust[2] < 0.4 < found.objects.trust[:2].min(), "and the values are not all alike"


def test_evidence_can_be_counted_once_a_second() -> None:
    counted, original = Mate(independent_s=1.0), Mate()
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.2, 0.0))]
    results = []
    for mate in (counted, original):
        for frame in range(2):
            assessment = mate.assess(batch(tracks, ("a", "b"), VIEWS, frame=frame))
        results.append(assessment.objects.trust[0])
    # The first batch counts nothing, the second a tenth of 2 * 1/2 * 1/2.
    assert results[0] == pytest.approx(0.55 / 1.05)
    assert results[1] == pytest.approx(1.45 / 1.95)
    assert STEP_NS == 100_000_000
