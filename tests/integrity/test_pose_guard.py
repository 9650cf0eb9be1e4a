"""`PoseGuard`: near the ego, what is fused must agree with what the ego sees."""

import numpy as np
import plain_boxes as plain
from hypothesis import given
from hypothesis import strategies as st
from integrity_batches import Track, batch, view

from mast_zenoh.integrity import Batch, PoseGuard
from mast_zenoh.integrity.visibility import current, seen_through

AGENTS = ("a", "b", "ego")
CARS = ((12.0, 3.0), (-14.0, 6.0))


def near_ego(frame: int = 0) -> Batch:
    """Three agents that report two cars near the ego; a and b displace the first by 1.5 m."""
    tracks: list[Track] = [
        (name, number, (x + 1.5 * (number == 0 and name != "ego"), y))
        for name in AGENTS
        for number, (x, y) in enumerate(CARS)
    ]
    return batch(tracks, AGENTS, {"ego": view((0.0, 0.0), *((x, y, 2.5) for x, y in CARS))}, frame=frame)


def transcribed(each: Batch, stage: PoseGuard) -> tuple[set[int], set[int], int]:
    """Rows that are left out, clusters that are withheld, and the number of checks."""
    names = list(each.agents)
    if stage.ego not in names or each.views[names.index(stage.ego)] is None:
        return set(), set(), 0
    ego = names.index(stage.ego)
    place = each.views[ego].view.position
    left_out, withheld, checks = set[int](), set[int](), 0
    for cluster in range(each.clusters):
        fused = plain.median_box(each, cluster, range(len(names)))
        if np.hypot(fused[0] - place[0], fused[1] - place[1]) > stage.region_m:
            continue
        checks += 1
        own = plain.median_box(each, cluster, [ego])
        rows = [row for row in range(len(each.labels)) if each.labels[row] == cluster]
        if own is None:
            boxes = plain.boxes_of([fused])
            velocity = np.median(each.states.velocity[rows], axis=0)
            boxes.velocity[:] = velocity
            if seen_through(boxes, current([each.views[ego]]))[0, 0]:
                withheld.add(cluster)
                left_out |= set(rows)
        elif plain.apart(fused, own) > stage.agree_m:
            left_out |= {row for row in rows if np.hypot(*(each.states.position[row, :2] - own[:2])) > stage.agree_m}
    return left_out, withheld, checks


@given(
    number=st.integers(0, 10_000),
    agents=st.integers(1, 5),
    objects=st.integers(0, 8),
    region_m=st.sampled_from([15.0, 30.0, 60.0]),
    agree_m=st.sampled_from([0.1, 0.5, 1.0]),
    ego=st.sampled_from(["agent_0", "agent_1", "absent"]),
    viewed=st.booleans(),
)
def test_it_leaves_out_and_withholds_what_the_transcribed_method_does(
    number: int, agents: int, objects: int, region_m: float, agree_m: float, ego: str, viewed: bool
) -> None:
    each = plain.random_batch(number, agents, objects, viewed=viewed)
    stage = PoseGuard(ego=ego, region_m=region_m, agree_m=agree_m)
    found = stage.assess(each)
    left_out, withheld, checks = transcribed(each, stage)
    assert set(np.flatnonzero(found.objects.withheld).tolist()) == withheld
    kept = set(range(len(each.labels))) - left_out
    alone = {c for c in range(each.clusters) if not any(each.labels[row] == c for row in kept)}
    expected = [row in kept or each.labels[row] in alone for row in range(len(each.labels))]
    assert found.weights is not None
    assert (found.weights > 0.0).tolist() == expected, "an object without any track keeps all, to be tracked on"
    assert stage.facts()["checks"] == checks


def test_agents_are_never_suspended_but_their_trust_falls() -> None:
    stage = PoseGuard()
    for frame in range(100):
        found = stage.assess(near_ego(frame))
    assert not found.agents.state.any()
    mean = dict(zip(AGENTS, found.agents.mean.tolist(), strict=True))
    assert mean["ego"] > 0.9
    assert mean["a"] == mean["b"] < 0.6, "one of its two tracks is left out"


def test_without_the_ego_or_its_view_nothing_is_checked_and_that_is_counted() -> None:
    stage = PoseGuard(ego="truck")
    stage.assess(near_ego())
    blind = PoseGuard()
    found = blind.assess(batch([("a", 0, (5.0, 0.0)), ("ego", 0, (7.0, 0.0))], AGENTS))
    assert found.weights is not None
    assert found.weights.all()
    for each in (stage, blind):
        facts = each.facts()
        assert (facts["batches"], facts["batches_without_reference"], facts["checks"]) == (0, 1, 0)
