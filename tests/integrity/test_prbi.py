"""`Prbi`: random groups are compared with the last believed picture, and nobody is trusted."""

from dataclasses import replace
from math import floor, log2, sqrt

import numpy as np
import plain_boxes as plain
import pytest
from hypothesis import given
from hypothesis import strategies as st
from integrity_batches import Track, batch
from scipy.stats import t as student

from mast_zenoh.integrity import Batch, Prbi, sightings
from mast_zenoh.integrity.base import SUSPENDED
from mast_zenoh.integrity.prbi import MAX_GAP_S, has_settled, posterior
from mast_zenoh.streams import stream

AGENTS = ("a", "b", "c", "d", "e")
CARS = tuple((12.0 * k - 30.0, 9.0) for k in range(6))


def seen_by_all(*liars: str, frame: int = 0, phantoms: int = 14) -> Batch:
    """Five agents that report six cars; some of them report phantoms of their own, too, elsewhere in each frame."""
    tracks: list[Track] = [(name, number, car) for name in AGENTS for number, car in enumerate(CARS)]
    for number, liar in enumerate(liars):
        first = len(CARS) + number * phantoms
        places = [(-60.0 + 9.0 * k, -20.0 - 30.0 * number - 5.0 * (frame % 3)) for k in range(phantoms)]
        tracks += [(liar, first + k, place) for k, place in enumerate(places)]
    return batch(tracks, AGENTS, frame=frame)


def suspended(stage: Prbi, each: Batch) -> set[str]:
    state = stage.assess(each).agents.state
    return {name for name, value in zip(each.agents, state.tolist(), strict=True) if value == SUSPENDED}


@given(
    groups=st.lists(st.tuples(st.lists(st.booleans(), min_size=4, max_size=4), st.booleans()), max_size=12),
    before=st.lists(st.floats(0.0, 1.0), min_size=4, max_size=4),
    short_term=st.floats(0.0, 1.0),
)
def test_the_probability_is_bayes_rule_with_counted_shares(groups, before, short_term):
    found = posterior(
        np.array([members for members, _ in groups], np.bool_).reshape(-1, 4),
        np.array([normal for _, normal in groups], np.bool_),
        np.array(before),
        short_term,
    )
    abnormal = [members for members, normal in groups if not normal]
    for j in range(4):
        own = [normal for members, normal in groups if members[j]]
        beta = sum(own) / len(own) if own else 1.0
        prior = short_term * before[j] + (1.0 - short_term) * beta
        if not abnormal:
            assert found[j] == pytest.approx(prior)
        elif beta == 0.0:
            assert found[j] == 0.0
        else:
            evidence = len(abnormal) / len(groups)
            without = [members for members, _ in groups if not members[j]]
            likelihood = (sum(not m[j] for m in abnormal) + evidence) / (len(without) + 1)
            assert found[j] == pytest.approx(min(likelihood * prior / evidence, 1.0))


@given(
    estimates=st.lists(st.floats(0.0, 4.0), max_size=8), number=st.integers(0, 4), level=st.sampled_from([0.01, 0.05])
)
def test_an_estimate_has_settled_if_a_t_test_does_not_reject_it(estimates, number, level):
    needed = 5
    found = has_settled(estimates[:needed], number, needed, float(student.ppf(1.0 - level / 2.0, needed - 1)))
    if len(estimates) < needed:
        assert not found
        return
    values = estimates[:needed]
    mean = sum(values) / needed
    deviation = sqrt(sum((value - mean) ** 2 for value in values) / (needed - 1))
    if deviation < 1e-6:
        return
    p = 2.0 * (1.0 - student.cdf(abs(mean - number) / deviation * sqrt(needed), needed - 1))
    assert found == (p >= level) or p == pytest.approx(level)


class Transcribed:
    """The method as the docstring of `Prbi` states it, with dicts of names and lists of boxes."""

    def __init__(self, agree: float, memory: int) -> None:
        self.agree, self.memory = agree, memory
        self.honest: dict[str, float] = {}
        self.excluded: set[str] = set()
        self.batches: list[list[tuple[set[str], bool]]] = []
        self.estimates: list[float] = []
        self.believed: list[tuple[plain.Box, tuple[float, float]]] | None = None
        self.time_ns = 0
        self.checks = 0

    def perception(self, each: Batch, names: list[str]) -> list[tuple[plain.Box, tuple[float, float]]]:
        """Median boxes with median velocities."""
        rows = [each.agents.index(name) for name in names]
        found = []
        for cluster in range(each.clusters):
            box = plain.median_box(each, cluster, rows)
            if box is not None:
                mine = (each.labels == cluster) & np.isin(each.agent, rows)
                velocity = np.median(each.states.velocity[mine], axis=0)
                found.append((box, (float(velocity[0]), float(velocity[1]))))
        return found

    def assess(self, each: Batch, random: np.random.Generator) -> tuple[dict[str, float], int]:
        """The probability that each agent is honest, and the number of checks."""
        dt, self.time_ns = (each.time_ns - self.time_ns) * 1e-9, each.time_ns
        self.checks = 0
        for name in each.agents:
            self.honest.setdefault(name, 1.0)
        candidates = [name for name in each.agents if name not in self.excluded]
        if not self.believed or not candidates or dt > 1.0:
            self.believed = self.perception(each, candidates)
        else:
            past = [((box[0] + v[0] * dt, box[1] + v[1] * dt, *box[2:]), v) for box, v in self.believed]
            self.judge(each, candidates, past, random)
        honest = {name: 0.0 if name in self.excluded else self.honest[name] for name in each.agents}
        return honest, self.checks

    def agreement(self, each: Batch, past: list, group: list[str]) -> float:
        self.checks += 1
        boxes = [box for box, _ in self.perception(each, group)]
        one = plain.boxes_of([box for box, _ in past])
        table = [[plain.iou(box, other) for other in boxes] for box, _ in past]
        from scipy.optimize import linear_sum_assignment

        cost = -np.array(table).reshape(len(past), len(boxes))
        pairs = [(i, j) for i, j in zip(*linear_sum_assignment(cost), strict=True) if table[i][j] >= 0.5]
        matched = {i for i, _ in pairs}
        in_view = sightings(one.position, one.size, one.yaw, each.views).in_view
        for i in range(len(past)):
            for name in group:
                column = each.agents.index(name)
                if each.views[column] is None or in_view[i, column]:
                    matched.add(i)
        if not matched or not boxes:
            return 0.0
        return len(pairs) / (len(matched) + len(boxes) - len(pairs))

    def m(self) -> float:
        outcomes = [normal for each in self.batches for _, normal in each]
        return log2(len(outcomes) / max(sum(outcomes), 0.5)) if outcomes else 0.0

    def judge(self, each: Batch, candidates: list[str], past: list, random: np.random.Generator) -> None:
        shuffled = random.permutation(len(candidates)).tolist()
        order = sorted(shuffled, key=lambda row: self.honest[candidates[row]])
        size = floor(self.m()) or int(random.binomial(len(candidates), 0.5))
        groups = [[candidates[row] for row in part] for part in (order[:size], order[size:]) if part]
        normal = [self.agreement(each, past, group) >= self.agree for group in groups]
        self.batches.append([(set(group), fits) for group, fits in zip(groups, normal, strict=True)])
        self.batches = self.batches[-self.memory :]
        checks = [check for each_ in self.batches for check in each_]
        table = np.array([[name in group for name in candidates] for group, _ in checks], np.bool_)
        result = posterior(
            table, np.array([fits for _, fits in checks]), np.array([self.honest[n] for n in candidates]), 0.5
        )
        self.honest |= dict(zip(candidates, result.tolist(), strict=True))
        above = [name for name in candidates if self.honest[name] > 0.0]
        believed: list[str] | None = candidates
        if not all(normal):
            believed = above
            if not above or self.agreement(each, past, above) < self.agree:
                believed = next((group for group, fits in zip(groups, normal, strict=True) if fits), None)
        self.believed = past if believed is None else self.perception(each, believed)
        zero = [name for name in candidates if self.honest[name] == 0.0]
        if zero == candidates and len(self.batches) == self.memory:
            self.honest |= dict.fromkeys(candidates, 1.0)
            self.batches, self.estimates = [], []
            self.believed = self.perception(each, candidates)
            return
        self.estimates = [*self.estimates, self.m()][-5:]
        if zero and zero != candidates and len(self.estimates) == 5:
            mean, deviation = np.mean(self.estimates), np.std(self.estimates, ddof=1)
            if abs(mean - len(zero)) <= max(student.ppf(0.975, 4) * deviation / sqrt(5), 1e-9):
                self.excluded |= set(zero)
                self.honest |= dict.fromkeys(above, 1.0)
                self.batches, self.estimates = [], []


@given(
    number=st.integers(0, 10_000),
    agents=st.integers(1, 5),
    objects=st.integers(0, 6),
    agree=st.sampled_from([0.2, 0.35, 0.6]),
    memory=st.sampled_from([3, 20]),
    viewed=st.booleans(),
)
def test_it_judges_as_the_transcribed_method(number, agents, objects, agree, memory, viewed):
    stage, expected = Prbi(agree=agree, memory=memory), Transcribed(agree, memory)
    stage.bind(number, "centre")
    for frame in range(10):
        each = plain.random_batch(number, agents, objects, frame=frame, viewed=viewed)
        before = stage.facts()["checks"]
        found = stage.assess(each)
        honest, checks = expected.assess(each, stream(number, "centre", "prbi", each.time_ns))
        assert found.agents.mean.tolist() == pytest.approx(list(honest.values()))
        assert {name for name, p in honest.items() if p == 0.0} == {
            name for name, state in zip(each.agents, found.agents.state.tolist(), strict=True) if state == SUSPENDED
        }
        assert stage.facts()["checks"] - before == checks
        assert set(stage.facts()["excluded"]) == expected.excluded


def test_two_of_five_that_begin_to_report_many_phantoms_are_excluded() -> None:
    stage = Prbi(memory=10)
    for frame in range(5):
        stage.assess(seen_by_all(frame=frame))
    groups = [suspended(stage, seen_by_all("b", "d", frame=frame)) for frame in range(5, 80)]
    assert set(stage.facts()["excluded"]) == {"b", "d"}
    assert groups[-1] == {"b", "d"}
    assert stage.facts()["most_checks"] == 3
    assert stage.facts()["checks_per_batch"] <= 3.0


def test_a_late_liar_is_never_at_0_if_all_batches_count() -> None:
    stage = Prbi(memory=None)
    for frame in range(80):
        found = suspended(stage, seen_by_all(*(["b"] if frame > 4 else []), frame=frame))
        assert "b" not in found
    assert stage.facts()["excluded"] == []


def driving(frame: int, gap_s: float) -> Batch:
    """Five agents that report six cars at 10 m/s, which turn back in a gap of some seconds after frame 10."""
    ahead = float(min(frame, 10) - max(frame - 10, 0)) - (5.0 * gap_s if frame > 10 else 0.0)
    places = [(x + ahead, y) for x, y in CARS]
    tracks: list[Track] = [(name, number, place) for name in AGENTS for number, place in enumerate(places)]
    velocity = dict.fromkeys(range(len(CARS)), (10.0 if frame <= 10 else -10.0, 0.0))
    each = batch(tracks, AGENTS, frame=frame, velocity=velocity)
    return replace(each, time_ns=each.time_ns + (int(gap_s * 1e9) if frame > 10 else 0))


@pytest.mark.parametrize(("gap_s", "memory"), [(1.5, 5), (60.0, 20)])
def test_after_a_gap_in_time_the_first_perception_is_the_reference(gap_s: float, memory: int) -> None:
    stage = Prbi(memory=memory)
    assert all(suspended(stage, driving(frame, gap_s)) == set() for frame in range(60))
    assert stage.facts()["excluded"] == []
    assert gap_s > MAX_GAP_S
    assert stage.facts()["batches_without_reference"] == 2


@pytest.mark.parametrize("jump", [1, 5])
def test_a_last_picture_that_no_agent_fits_any_more_is_replaced_and_excludes_nobody(jump: int) -> None:
    stage = Prbi(memory=5)
    for frame in range(jump):
        stage.assess(seen_by_all(frame=frame))
    tracks: list[Track] = [(name, k, (x, y + 40.0)) for name in AGENTS for k, (x, y) in enumerate(CARS)]
    groups = [suspended(stage, batch(tracks, AGENTS, frame=jump + frame)) for frame in range(30)]
    before = [set(AGENTS)] * 4 if jump == 1 else [set()] * 4
    assert groups == before + [set()] * 26, "as soon as no remembered check is normal"
    assert stage.facts()["excluded"] == []
