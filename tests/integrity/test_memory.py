"""Objects and agents are followed from batch to batch."""

import numpy as np

from mast_zenoh.integrity import memory as module
from mast_zenoh.integrity.memory import NOW, AgentMemory, ObjectMemory

STEP_NS = 100_000_000


def at(*places: tuple[float, float]) -> np.ndarray:
    return np.array([[x, y, 0.0] for x, y in places]).reshape(-1, 3)


def test_an_object_keeps_its_row_while_it_moves() -> None:
    memory, velocity = ObjectMemory(), at((20.0, 0.0), (-20.0, 0.0))
    for frame in range(10):
        rows = memory.follow(frame * STEP_NS, at((0.0, 0.0), (20.0, 0.5)) + velocity * (frame * 0.1), velocity)
        assert rows.tolist() == [0, 1], "they pass each other at the fifth frame"
    assert memory.of.frames.tolist() == [10, 10]
    assert memory.age_s(9 * STEP_NS).tolist() == [0.9, 0.9]


def test_values_follow_their_objects_through_arrival_and_forgetting() -> None:
    memory, still = ObjectMemory(forget_s=1.0, doubt=7.0, since_ns=NOW), at((0.0, 0.0))
    memory.follow(0, at((0.0, 0.0)), still)
    assert memory.of.doubt.tolist() == [7.0]
    memory.of.doubt[0] = 1.0
    rows = memory.follow(STEP_NS, at((50.0, 0.0)), still)
    assert memory.of.doubt[rows].tolist() == [7.0]
    assert memory.of.doubt.tolist() == [1.0, 7.0], "an object without a cluster is remembered"
    memory.follow(11 * STEP_NS, at((50.0, 0.0)), still)
    assert memory.of.doubt.tolist() == [7.0], "the first was seen more than a second ago"
    assert memory.of.since_ns.tolist() == memory.of.first_ns.tolist() == [STEP_NS]
    assert memory.of.number.tolist() == [1], "numbers are not used again"


def test_a_value_for_each_agent_and_object_is_carried_along_either_axis() -> None:
    memory = AgentMemory()
    assert memory.meet(0, ("b", "d")).tolist() == [0, 1]
    table = np.array([[1.0, 2.0]])
    rows = memory.meet(STEP_NS, ("a", "b", "c", "d"))
    assert memory.carry(table, 0.5, axis=1)[:, rows].tolist() == [[0.5, 1.0, 0.5, 2.0]]


def test_an_agent_returns_under_its_row_until_it_is_forgotten() -> None:
    memory = AgentMemory(forget_s=1.0)
    memory.meet(0, ("a", "b"))
    memory.meet(5 * STEP_NS, ("b",))
    assert memory.meet(10 * STEP_NS, ("a", "b")).tolist() == [0, 1]
    memory.meet(20 * STEP_NS, ("b",))
    memory.meet(21 * STEP_NS, ("a", "b"))
    assert memory.names == ("b", "a")


def test_the_gate_widens_with_the_time_without_a_cluster() -> None:
    for gap, offset, same in ((1, 1.9, True), (1, 2.1, False), (10, 4.2, True), (10, 4.3, False)):
        memory = ObjectMemory()
        memory.follow(0, at((0.0, 0.0)), at((1.0, 0.0)))
        rows = memory.follow(gap * STEP_NS, at((gap * 0.1 + offset, 0.0)), at((1.0, 0.0)))
        assert (rows.tolist() == [0]) is same, (gap, offset)


def test_rows_do_not_depend_on_the_order_of_the_clusters() -> None:
    random = np.random.default_rng(3)
    memory, shuffled = ObjectMemory(), ObjectMemory()
    for frame in range(5):
        position = np.column_stack([random.uniform(0.0, 60.0, (40, 2)), np.zeros(40)])
        order = random.permutation(40)
        rows = memory.follow(frame * STEP_NS, position, 0.0 * position)
        others = shuffled.follow(frame * STEP_NS, position[order], 0.0 * position)
        assert np.array_equal(memory.of.frames[rows[order]], shuffled.of.frames[others])


def test_the_memory_is_bounded() -> None:
    memory = ObjectMemory(forget_s=1e6)
    many = np.zeros((module.MAX_OBJECTS, 3))
    many[:, 0] = np.arange(len(many)) * 10.0
    memory.follow(0, many, 0.0 * many)
    memory.follow(STEP_NS, at((-50.0, 0.0)), at((0.0, 0.0)))
    memory.follow(2 * STEP_NS, at((-90.0, 0.0)), at((0.0, 0.0)))
    assert len(memory) == module.MAX_OBJECTS + 1
    agents = AgentMemory(forget_s=1e6)
    for batch in range(3):
        agents.meet(batch, tuple(f"{batch}_{row}" for row in range(module.MAX_AGENTS)))
    assert len(agents) == 2 * module.MAX_AGENTS
