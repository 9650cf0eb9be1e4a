"""The median of an object's tracks shows which agent is off, and the run what is usual."""

from dataclasses import replace

import numpy as np
import pytest
from integrity_batches import Track, batch

from mast_zenoh.arrays.states import Floats
from mast_zenoh.integrity.base import Batch, ClusterBoxes
from mast_zenoh.integrity.deviations import (
    CLIP,
    HEADING,
    POSITION,
    RANKS,
    SIZE,
    USUAL,
    USUAL_FACTOR,
    VELOCITY,
    Deviations,
    LastingDeviations,
    Means,
    deviations,
    displacements,
)
from mast_zenoh.integrity.sequential import UNEXPLAINED

AGENTS = ("a", "b", "c")


def measured(given: Batch, *weight: float) -> Deviations:
    return deviations(given, ClusterBoxes.of(given), np.array(weight or (1.0,) * len(given.agents)))


def three(**changed: Floats) -> Deviations:
    """Deviations of three agents' tracks of one car that drives north, in which those of `c` are changed."""
    given = batch([(name, 0, (0.0, 0.0)) for name in AGENTS], AGENTS, velocity={0: (0.0, 8.0)})
    columns = {name: getattr(given.states, name).copy() for name in changed}
    for name, value in changed.items():
        columns[name][2] = value
    return measured(replace(given, states=given.states.with_(**columns)))


def test_the_middle_is_that_of_the_agents_that_count() -> None:
    tracks: list[Track] = [(name, 0, (float(x), 0.0)) for x, name in enumerate("abcd")]
    found = measured(batch(tracks, tuple("abcd")), 0.0, 1.0, 1.0, 1.0)
    assert found.whitened[2, POSITION, 0] == 0.0, "b, c and d count, and c is their middle"
    assert found.whitened[0, POSITION, 0] < 0.0, "a does not count, and is measured all the same"


@pytest.mark.parametrize(
    ("changed", "quantity"),
    [
        (dict(position=np.array([1.5, 0.0, 0.75])), POSITION),
        (dict(velocity=np.array([8.0, 0.0, 0.0])), VELOCITY),
        (dict(yaw=0.5 * np.pi), HEADING),
        (dict(size=np.array([6.5, 1.8, 1.5])), SIZE),
    ],
)
def test_each_quantity_is_compared_by_itself(changed: dict[str, Floats], quantity: int) -> None:
    length = np.hypot(*three(**changed).whitened[2].T)
    assert length[quantity] > 3.0
    assert not np.delete(length, quantity).any()


def test_a_heading_is_compared_by_its_axis() -> None:
    assert three(yaw=np.pi).whitened[2, HEADING] == pytest.approx([0.0, 0.0], abs=1e-9)
    small = three(yaw=0.05)
    assert small.whitened[2, HEADING, 1] * small.std[2, HEADING] == pytest.approx(0.05, rel=0.01)


def test_the_headings_of_square_boxes_and_the_sizes_of_pedestrians_are_not_judged() -> None:
    given = batch([(name, 0, (0.0, 0.0)) for name in AGENTS], AGENTS, size={0: (0.8, 0.6, 1.8)})
    wrong = given.states.with_(yaw=np.array([0.0, 0.0, 1.5]), size=given.states.size * [[1.0], [1.0], [1.4]])
    assert not measured(replace(given, states=wrong)).whitened.any()


def test_an_uncertainty_that_a_track_claims_helps_it_to_some_extent_only() -> None:
    small, large, huge = (
        abs(three(position=np.array([1.5, 0.0, 0.75]), covariance=variance * np.eye(9)).whitened[2, POSITION, 0])
        for variance in (0.04, 1.0, 1e6)
    )
    assert small > 2.0 * large
    assert large == huge > 1.2


@pytest.mark.parametrize("others", [[], [("a", 1, (2.0, 0.0)), ("b", 1, (2.0, 0.0)), ("c", 1, (2.0, 0.0))]])
def test_two_tracks_and_crowded_objects_have_no_middle(others: list[Track]) -> None:
    tracks: list[Track] = [("a", 0, (0.0, 0.0)), ("b", 0, (0.1, 0.0))]
    tracks += [("c", 0, (0.0, 0.1))] if others else []
    assert not len(measured(batch([*tracks, *others], AGENTS)).cluster)


def of(*x: float, agents: int = 1) -> Deviations:
    """Deviations in x of the positions of some agents' tracks of some objects, standard deviation 1 m."""
    cluster, agent = np.divmod(np.arange(len(x) * agents), agents)
    whitened = np.zeros((len(cluster), 4, 2))
    whitened[:, POSITION, 0] = np.array(x)[cluster]
    return Deviations(cluster, agent, whitened, np.ones((len(cluster), 4), np.bool_), np.ones((len(cluster), 4)))


def means(lasting: LastingDeviations, frame: int, given: Deviations, agents: int = 1, first: int = 0) -> Means:
    numbers = np.arange(agents), np.arange(first, first + 1 + given.cluster.max(initial=0))
    return lasting.update(frame * 100_000_000, *numbers, given, np.ones(agents, np.bool_))


def test_a_deviation_counts_the_more_the_longer_it_lasts_up_to_its_own_size() -> None:
    lasting = LastingDeviations()
    at_once, lasts = np.array(
        [(found.length * found.usual)[0, :2] for frame in range(200) for found in [means(lasting, frame, of(1.0))]]
    ).T
    assert at_once[3] > 0.6
    assert lasts[3] < 0.2
    assert lasts[60] > 0.8
    assert max(at_once[-1], lasts[-1]) <= 1.0


def test_a_track_that_comes_back_begins_anew() -> None:
    lasting = LastingDeviations()
    first = means(lasting, 0, of(3.0)).length[0, 1]
    for frame in range(1, 30):
        means(lasting, frame, of(3.0))
    assert means(lasting, 1000, of(3.0)).length[0, 1] <= 3.0 * first


def test_deviations_are_forgotten_by_agent() -> None:
    lasting = LastingDeviations()
    for frame in range(10):
        means(lasting, frame, of(1.0, agents=2), 2)
    lasting.forget(0)
    one, other = means(lasting, 10, of(1.0, agents=2), 2).length
    assert one[1] < 0.3 * other[1]


def test_remembered_deviations_are_bounded() -> None:
    lasting = LastingDeviations(limit=5)
    for frame in range(20):
        means(lasting, frame, of(1.0, 1.0, 1.0), first=3 * frame)
    assert len(lasting._row) <= 5


def test_what_is_usual_in_the_run_counts_less_and_a_minority_cannot_stretch_it() -> None:
    random = np.random.default_rng(1)

    def after(sizes: tuple[float, ...]) -> Floats:
        """Usual lengths where each of five agents errs by so much about twenty objects."""
        lasting = LastingDeviations()
        error = random.normal(0.0, 1.0, (100, 4, 2)) * np.repeat(sizes, 20)[:, None, None]
        agent, cluster = np.divmod(np.arange(100), 20)
        given = Deviations(cluster, agent, error, np.ones((100, 4), np.bool_), np.ones((100, 4)))
        for frame in range(600):
            means(lasting, frame, given, 5)
        return lasting._usual

    exact, wild, two_lie = after((0.05,) * 5), after((9.0,) * 5), after((0.05, 0.05, 0.05, 9.0, 9.0))
    assert wild == pytest.approx(USUAL_FACTOR * USUAL, rel=0.01)
    assert exact == pytest.approx(USUAL / USUAL_FACTOR, rel=0.1)
    assert two_lie == pytest.approx(exact, rel=0.1)


def test_one_wild_deviation_counts_no_more_than_the_limit() -> None:
    wild, limit = (means(LastingDeviations(), 0, of(size)).length.max() for size in (1e6, CLIP))
    assert wild == pytest.approx(limit)


def test_tracks_of_one_object_are_compared_with_each_other() -> None:
    lasting = LastingDeviations()
    given = of(0.0, agents=3)
    given.whitened[:, POSITION, 0] = 0.0, 0.0, 6.0
    for frame in range(30):
        found = means(lasting, frame, given, 3)
    one, other, difference = found.apart(found.length.max(axis=1) > 5.0)
    assert (one.tolist(), other.tolist()) == ([2, 2], [0, 1])
    assert difference == pytest.approx(found.length[2].max() / np.sqrt(2.0))


@pytest.mark.parametrize("later", [10, 25])
def test_two_tracks_that_liars_moved_the_middle_from_are_not_apart_because_one_began_later(later: int) -> None:
    lasting = LastingDeviations()
    given = of(6.0, agents=2)
    for frame in range(30):
        some = np.arange(2) < (1 if frame < later else 2)
        columns = given.cluster, given.agent, given.whitened, given.judged, given.std
        found = means(lasting, frame, Deviations(*(column[some] for column in columns)), 2)
    assert found.length[0, 1] > 1.1 * found.length[1, 1]
    assert found.apart(np.ones(2, np.bool_))[2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_deviation_is_a_lie_as_far_as_no_fault_of_the_agent_explains_it(seed: int) -> None:
    random = np.random.default_rng(seed)
    arm, velocity = random.uniform(-50.0, 50.0, (12, 2)), random.uniform(-12.0, 12.0, (12, 2))
    design = displacements(arm, velocity)

    def left(moved: Floats) -> float:
        mean = np.zeros((12, 5, 2))
        mean[:, 1] = (moved + random.normal(0.0, 0.15, (12, 2))) / 0.1
        return Means(
            np.arange(12), np.zeros(12, np.int64), mean, np.full((12, 5), 0.1), np.ones((12, 5))
        ).left_by_fault(0, 1, design)

    for fault in ([1.0, -0.5, 0.0, 0.0], [0.0, 0.0, 0.03, 0.0], [0.0, 0.0, 0.0, 0.2]):
        assert left(design @ fault) < 0.5 * UNEXPLAINED
    one, half = np.zeros((12, 2)), np.zeros((12, 2))
    one[4] = half[::2] = 1.0, 0.0
    assert left(one) > UNEXPLAINED
    assert left(half) > UNEXPLAINED


def test_several_smaller_deviations_are_as_much_evidence_as_one() -> None:
    mean = np.zeros((6, 5, 2))
    mean[:, 1, 0] = 8.0, 1.0, 1.0, 6.0, 6.0, 6.0
    agent = np.repeat([0, 1], 3)
    statistics, tracks = Means(np.tile(np.arange(3), 2), agent, mean, *np.ones((2, 6, 5))).of_agents(3)
    assert statistics.tolist() == pytest.approx([8.0, 6.0 * RANKS[2], 0.0])
    assert tracks.tolist() == [True, False, False, True, True, True]
