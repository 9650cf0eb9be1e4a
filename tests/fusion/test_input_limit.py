"""Limits on the rows that fusion gets: no agent displaces the rows of others, or objects that were there before."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.fusion.input_limit import ClaimedObjects, FairInput, InputLimit, NoInputLimit, fair_shares

#: Objects of each agent in one frame: ids with scores.
Frame = dict[int, dict[int, float]]


def kept(limit: InputLimit, frame: Frame) -> dict[int, set[int]]:
    """Ids that are kept in a frame, by agent."""
    objects = {
        str(agent): ClaimedObjects(np.array(list(scores), np.int64), np.array(list(scores.values()), np.float64))
        for agent, scores in frame.items()
    }
    selected = limit.select(objects)
    for agent, rows in selected.items():
        assert rows.tolist() == sorted(set(rows.tolist()))
        assert len(rows) < len(objects[agent].ids)
    return {agent: set(objects[str(agent)].ids[selected.get(str(agent), slice(None))].tolist()) for agent in frame}


def by_name(values: list[int]) -> dict[str, int]:
    """Values by the names a, b, c, ..."""
    return {chr(ord("a") + place): value for place, value in enumerate(values)}


def some(count: int, first: int = 0, score: float = 0.5) -> dict[int, float]:
    """Objects of equal score."""
    return dict.fromkeys(range(first, first + count), score)


def test_without_a_limit_all_rows_are_kept() -> None:
    assert kept(NoInputLimit(), {0: some(3), 5: some(1000)}) == {0: set(range(3)), 5: set(range(1000))}


def test_rows_that_were_cut_from_a_message_count_as_sent() -> None:
    limit = FairInput(rows=100)
    for beyond, expected in ((0, 40), (0, 40), (19_960, 54), (0, 60)):  # 54: a third more than before
        sent = {0: some(60 if beyond or expected == 60 else 40), 1: some(30)}
        objects = {
            str(agent): ClaimedObjects(
                np.array(list(ids), np.int64), np.full(len(ids), 0.5), beyond if agent == 0 else 0
            )
            for agent, ids in sent.items()
        }
        selected = limit.select(objects)
        assert len(selected.get("0", sent[0])) == expected
        assert "1" not in selected


@given(count=st.lists(st.integers(1, 30), max_size=12), rows=st.integers(1, 100))
def test_shares_equal_dealing_row_by_row(count: list[int], rows: int) -> None:
    dealt = [0] * len(count)
    for _ in range(min(rows, sum(count))):
        hungry = [agent for agent, most in enumerate(count) if dealt[agent] < most]
        dealt[min(hungry, key=lambda agent: (dealt[agent], agent))] += 1
    assert fair_shares(by_name(count), rows) == by_name(dealt)


def test_of_new_objects_those_of_high_score_are_kept() -> None:
    assert kept(FairInput(rows=2), {0: {1: 0.2, 2: 0.9, 3: 0.5, 4: 0.1}}) == {0: {2, 3}}


def test_a_flood_displaces_at_most_the_reserve_and_the_youngest_objects_first() -> None:
    limit = FairInput(rows=20, reserve=0.25)
    kept(limit, {0: some(12, score=0.3)})
    kept(limit, {0: some(20, score=0.3)})
    for frame in range(30):
        selected = kept(limit, {0: some(20, score=0.3) | some(5000, 1000 + 5000 * frame, score=1.0)})
        assert selected[0] >= set(range(15))


@given(before=st.integers(1, 20), reserve=st.floats(0.0, 0.3), flood=st.integers(100, 500))
def test_a_flood_costs_no_object_that_was_there_before_and_little_more_than_these(before, reserve, flood):
    limit = FairInput(rows=60, reserve=reserve)
    others = {agent: some(10) for agent in (1, 2, 3)}
    kept(limit, others | {0: some(before, score=0.1)})
    for number in range(12):
        attacked = others | {0: some(before, score=0.1) | some(flood, 1000 + 500 * number, score=1.0)}
        selected = kept(limit, attacked)
        assert selected[0] >= set(range(before))
        assert len(selected[0]) <= max(60 // 4, np.ceil(before / (1.0 - reserve)))
        assert all(selected[agent] == set(others[agent]) for agent in others)


def test_a_new_object_is_seen_although_old_ones_fill_the_share() -> None:
    limit = FairInput(rows=20)
    for _ in range(3):
        kept(limit, {0: some(30)})
    assert 99 in kept(limit, {0: some(30) | {99: 0.9}})[0]


def test_without_new_objects_the_reserve_is_not_wasted() -> None:
    limit = FairInput(rows=4, reserve=0.5)
    kept(limit, {0: some(4)})
    assert kept(limit, {0: some(4), 1: {}}) == {0: {0, 1, 2, 3}, 1: set()}
    assert len(kept(limit, {0: some(4), 1: some(1)})[0]) == 3


def test_an_object_that_returns_soon_keeps_its_place_and_later_is_new() -> None:
    for pause, is_kept in ((2, True), (3, False)):
        limit = FairInput(rows=1, reserve=0.0, memory_frames=3)
        kept(limit, {0: {1: 0.1}})
        for _ in range(pause):
            kept(limit, {0: {}})
        assert (kept(limit, {0: {1: 0.1, 2: 0.9}})[0] == {1}) is is_kept


def test_an_id_is_known_only_within_its_agent() -> None:
    limit = FairInput(rows=2, reserve=0.0)
    kept(limit, {0: {7: 0.1}, 1: {8: 0.1}})
    assert kept(limit, {0: {7: 0.1, 8: 0.9}, 1: {8: 0.1, 7: 0.9}}) == {0: {7}, 1: {8}}


def test_memory_is_bounded_whatever_ids_arrive() -> None:
    limit = FairInput(rows=20, memory_frames=5)
    for frame in range(20):
        kept(limit, {agent: some(50, 50 * frame) for agent in range(3)})
        assert sum(map(len, limit.kept.values())) <= 20 * 5


OBJECTS = st.dictionaries(st.integers(-3, 12), st.sampled_from([0.0, 0.3, 0.7, 1.0]), max_size=12)
FRAMES = st.lists(st.dictionaries(st.integers(0, 4), OBJECTS, max_size=5), min_size=1, max_size=8)


@given(frames=FRAMES, rows=st.integers(1, 40), reserve=st.floats(0.0, 1.0))
def test_the_limit_is_never_exceeded_and_up_to_it_all_is_kept(frames: list[Frame], rows: int, reserve: float) -> None:
    limit = FairInput(rows=rows, reserve=reserve)
    for frame in frames:
        total = sum(map(len, frame.values()))
        left = sum(map(len, kept(limit, frame).values()))
        assert left == total if total <= rows else left <= rows


@given(frames=FRAMES, rows=st.integers(1, 40), seed=st.integers(0, 100))
def test_the_selection_does_not_depend_on_the_order_of_rows(frames: list[Frame], rows: int, seed: int) -> None:
    plain, shuffled = FairInput(rows=rows), FairInput(rows=rows)
    rng = np.random.default_rng(seed)
    for frame in frames:
        agents = [agent for agent in frame if frame[agent]]
        order = {agent: rng.permutation(list(frame[agent])).tolist() for agent in rng.permutation(agents).tolist()}
        other = {agent: {id_: frame[agent][id_] for id_ in ids} for agent, ids in order.items()}
        assert {agent: ids for agent, ids in kept(plain, frame).items() if ids} == {
            agent: ids for agent, ids in kept(shuffled, other).items() if ids
        }


@given(frames=FRAMES, rows=st.integers(5, 40), flood=st.integers(1, 200), score=st.floats(0.0, 1.0))
def test_a_flooding_agent_never_costs_an_agent_within_its_share_a_row(frames, rows, flood, score):
    limit = FairInput(rows=rows)
    for number, frame in enumerate(frames):
        attacked = frame | {9: some(flood, flood * number, score)}
        selected = kept(limit, attacked)
        guaranteed = rows // sum(1 for objects in attacked.values() if objects)
        for agent, objects in frame.items():
            assert len(selected[agent]) >= min(len(objects), guaranteed)


@given(frames=FRAMES, rows=st.integers(1, 40), others=st.integers(0, 50))
def test_which_objects_an_agent_keeps_depends_on_others_only_by_its_share(frames, rows, others):
    """Two floods of equal size and different ids and scores have the same effect on all others."""
    low, high = FairInput(rows=rows), FairInput(rows=rows)
    for number, frame in enumerate(frames):
        first = kept(low, frame | {9: some(others)})
        second = kept(high, frame | {9: some(others, 1000 * number, 1.0)})
        assert {agent: first[agent] for agent in frame} == {agent: second[agent] for agent in frame}


def test_ids_of_any_size_are_compared_exactly() -> None:
    limit = FairInput(rows=2, reserve=0.0)
    kept(limit, {0: {2**62: 0.0, 2**62 + 1: 0.0}})
    assert kept(limit, {0: {2**62: 0.0, 2**62 + 1: 0.0, -(2**63): 1.0}}) == {0: {2**62, 2**62 + 1}}


def test_a_message_is_cut_to_what_was_kept_and_new_objects_of_high_score() -> None:
    limit = FairInput(rows=50)
    kept(limit, {0: some(20, score=0.1)})
    ids = np.random.default_rng(0).permutation(20_000)
    rows = limit.cut(limit.kept["0"], ClaimedObjects(ids, np.where(ids < 10_000, 0.5, 0.9)), 40)
    assert sorted(ids[rows].tolist()) == [*range(20), *range(10_000, 10_020)]


def test_cutting_a_message_changes_nothing_that_is_remembered() -> None:
    limit = FairInput(rows=50)
    kept(limit, {0: some(20)})
    before = limit.kept
    limit.cut(before["0"], ClaimedObjects(np.arange(1000), np.ones(1000)), 40)
    assert limit.kept is before
