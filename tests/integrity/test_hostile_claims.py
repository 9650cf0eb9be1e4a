"""What an agent says about itself neither frames others nor hides its lies."""

from dataclasses import replace

import numpy as np
import pytest
from integrity_batches import CAR, STEP_NS, Track, batch, view

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.config import registry
from mast_zenoh.fusion.pipelines import Pipeline
from mast_zenoh.integrity import FaultOrLie, FreeSpace, SequentialConsistency, TruthDiscovery
from mast_zenoh.integrity.base import SUSPENDED, Batch, Integrity
from mast_zenoh.integrity.disputes import Evidence, Explanations
from mast_zenoh.integrity.existence import ExistenceVotes
from mast_zenoh.integrity.memory import AgentMemory
from mast_zenoh.integrity.relative_faults import MAX_NEAR, MAX_TRACKS, Differences
from mast_zenoh.integrity.views import MAX_CELLS, check_view, collated_columns, view_columns
from mast_zenoh.messages.layout import MAX_ROWS

PLACES = {"a": (-20.0, 0.0), "b": (20.0, 0.0), "c": (0.0, 20.0), "d": (0.0, -20.0)}
CARS = ((9.0, 9.0), (-9.0, 9.0))
PHANTOM = (0.0, 0.0)
#: Two phantoms of `d`: one alone suspends nobody.
TWO: list[Track] = [("d", 2, PHANTOM), ("d", 3, (8.0, -10.0))]
STAGES: list[type[Integrity]] = [SequentialConsistency, FaultOrLie, TruthDiscovery]


def honest(frame: int, *more: Track, age_s: float = 0.0) -> Batch:
    """Four agents that see two cars, and some more tracks; the view of `d` ends at its own further tracks."""
    tracks: list[Track] = [(name, i, car) for name in PLACES for i, car in enumerate(CARS)]
    seen = [(*car, 2.5) for car in CARS]
    views = {name: view(place, *seen) for name, place in PLACES.items()}
    views["d"] = view(PLACES["d"], *seen, *((*place, 2.5) for name, _, place in more if name == "d"))
    views["d"] = replace(views["d"], age_s=age_s)
    return batch([*tracks, *more], tuple(PLACES), views, frame=frame)


def altered(given: Batch, rows: np.ndarray | int, **changes) -> Batch:
    """A batch in which columns of some rows are functions of what they were, or other values."""
    columns = {name: getattr(given.states, name).copy() for name in changes}
    for name, change in changes.items():
        columns[name][rows] = change(columns[name][rows]) if callable(change) else change
    return replace(given, states=given.states.with_(**columns))


def of_d(frames: int, **changes) -> list[Batch]:
    """Batches in which `d` alters its tracks."""
    return [altered(given, given.agent == 3, **changes) for given in map(honest, range(frames))]


def along_x(offset_m: float):
    return lambda position: position + np.array([offset_m, 0.0, 0.0])


def suspended(stage: Integrity, batches: list[Batch]) -> set[str]:
    """The agents that were ever suspended."""
    names = set()
    for each in batches:
        result = stage.assess(each).agents
        names |= {name for name, state in zip(each.agents, result.state, strict=True) if state == SUSPENDED}
    return names


@pytest.mark.parametrize("stage", [*STAGES, FreeSpace])
def test_false_heights_of_one_agent_do_not_frame_the_others(stage: type[Integrity]) -> None:
    batches = of_d(60, position=lambda position: position - np.array([0.0, 0.0, 15.0]))
    judge = stage()
    assert suspended(judge, batches) <= {"d"}
    assert not judge.assess(batches[-1]).objects.withheld.any()


@pytest.mark.parametrize("deviation_m", [0.2, 2.0, 20.0])
def test_a_phantom_is_refuted_however_uncertain_it_claims_to_be(deviation_m: float) -> None:
    covariance = np.eye(9) * np.repeat([deviation_m**2, 0.05], [2, 7])
    batches = [altered(honest(frame, *TWO), np.array([-2, -1]), covariance=covariance) for frame in range(60)]
    assert suspended(SequentialConsistency(), batches) == {"d"}


def test_an_offset_is_found_however_uncertain_its_track_claims_to_be() -> None:
    batches = of_d(200, covariance=np.eye(9) * 25.0, position=along_x(2.1))
    assert suspended(SequentialConsistency(), batches) == {"d"}


@pytest.mark.parametrize("offset_m", [1.3, 1.8])
def test_two_liars_that_move_middles_do_not_frame_one_of_two_honest_agents_that_differ(offset_m: float) -> None:
    """The liars and the other honest agent would be three of five that disagree with it."""
    places = {"a": -0.3, "b": 0.3, "d": offset_m, "e": offset_m}
    batches = []
    for frame in range(100):
        tracks: list[Track] = [(name, 0, CARS[0]) for name in "abcde"]
        tracks += [(name, cluster, (x, 20.0 * cluster)) for name, x in places.items() for cluster in (1, 2)]
        batches.append(batch(tracks, tuple("abcde"), frame=frame))
    assert suspended(SequentialConsistency(), batches) == set()


def test_an_offset_is_found_under_a_new_id_in_every_frame() -> None:
    batches = [
        altered(given, given.agent == 3, position=along_x(1.0), id=lambda id, frame=frame: id + 10 * frame)
        for frame, given in enumerate(map(honest, range(100)))
    ]
    assert suspended(SequentialConsistency(), batches) == {"d"}


def test_two_tracks_of_each_object_frame_nobody_and_are_a_lie() -> None:
    batches = []
    for frame in range(100):
        tracks: list[Track] = []
        for number, (x, y) in enumerate(CARS):  # the others' tracks fall into two clusters of one car
            tracks += [("d", 2 * number, (x - 0.2, y)), ("a", 2 * number, (x - 0.1, y)), ("b", 2 * number, (x, y))]
            tracks += [("d", 2 * number + 1, (x + 0.2, y)), ("c", 2 * number + 1, (x + 0.1, y))]
        views = {name: view(place, *[(*car, 2.5) for car in CARS]) for name, place in PLACES.items()}
        batches.append(batch(tracks, tuple(PLACES), views, frame=frame))
    stage = SequentialConsistency()
    assert suspended(stage, batches) == {"d"}
    assert stage.assess(batches[-1]).agents.reason[3].startswith("reports one object")


@pytest.mark.parametrize(("height_m", "size"), [(20.0, CAR), (0.75, (4.5, 1.8, 40.0)), (0.75, (0.0, 0.0, 0.0))])
def test_what_no_road_user_can_be_is_withheld_and_a_lie(height_m: float, size: tuple[float, float, float]) -> None:
    height = np.array([0.0, 0.0, height_m - 0.75])
    changes = dict(position=lambda position: position + height, size=size)
    batches = [altered(honest(frame, *TWO), np.array([-2, -1]), **changes) for frame in range(60)]
    stage = SequentialConsistency()
    assert suspended(stage, batches) == {"d"}
    assert stage.assess(batches[-1]).objects.withheld.tolist() == [False, False, True, True]


def test_where_two_halves_disagree_about_a_position_nobody_is_off() -> None:
    batches = [altered(given, given.agent >= 2, position=along_x(0.6)) for given in map(honest, range(200))]
    assert suspended(SequentialConsistency(), batches) == set()


def test_an_agent_that_stays_off_is_not_trusted_again() -> None:
    stage = SequentialConsistency(release_s=3.0)
    states = [stage.assess(each).agents.state.tolist()[3] for each in of_d(200, position=along_x(1.2))]
    first = states.index(SUSPENDED)
    assert set(states[first:]) == {SUSPENDED}


@pytest.mark.parametrize(("witnesses", "believed"), [("ab", False), ("ac", True)])
def test_what_only_liars_confirmed_leaves_the_picture_with_them(witnesses: str, believed: bool) -> None:
    agents = AgentMemory(suspended=False, misdescribes=False, **ExistenceVotes.COLUMNS)
    votes = ExistenceVotes(agents)
    for frame, lying in enumerate(["", "", "ab"]):  # `a` and `b` are suspended in the last frame
        reporting = witnesses if not lying else "ab"
        given = batch([(name, 0, PHANTOM) for name in reporting], tuple(PLACES), frame=frame)
        trusted = np.array([name not in lying for name in given.agents])
        rows = agents.meet(given.time_ns, given.agents)
        agents.of.suspended[rows] = ~trusted
        evidence = Evidence.of(given, trusted)
        votes.follow(given.time_ns, evidence.boxes)
        found, _ = votes.settle(evidence, Explanations(np.zeros((4, 4), np.bool_), *np.zeros((2, 4), np.bool_)))
        assert not found.withheld[0] or lying
    assert found.withheld.tolist() == [not believed]


def test_a_liar_does_not_take_along_that_others_confirmed_an_object_when_it_leaves_it() -> None:
    agents = AgentMemory(suspended=False, misdescribes=False, **ExistenceVotes.COLUMNS)
    votes = ExistenceVotes(agents)
    nobody = Explanations(np.zeros((4, 4), np.bool_), *np.zeros((2, 4), np.bool_))
    for frame in range(40):
        away = 0.0 if frame < 20 else 0.8 * (frame - 19)  # `a` goes on with the object, which stands where it was
        tracks: list[Track] = [("a", 0, (away, 0.0))]
        tracks += [("b", 0, (0.0, 0.0))] if frame < 20 else [("b", 1, (0.0, 0.0))] * (frame > 20)
        given = batch(tracks, tuple(PLACES), frame=frame)
        ids = np.where(given.agent == 1, 7, given.states.id)  # `b` has one track all the time
        velocity = np.zeros((len(ids), 3))
        velocity[given.labels == 0, 0] = 8.0 * (frame >= 19)
        given = replace(given, states=given.states.with_(id=ids, velocity=velocity))
        agents.meet(given.time_ns, given.agents)
        evidence = Evidence.of(given, np.ones(4, np.bool_))
        votes.follow(given.time_ns, evidence.boxes)
        votes.settle(evidence, nobody)
        confirmed = votes._confirmed(np.ones(4, np.bool_))
        assert confirmed[0] == (frame < 21)


def test_a_view_that_is_too_old_to_be_held_against_its_agent_has_no_vote() -> None:
    given = honest(0, ("a", 2, (30.0, -30.0)), age_s=0.06)
    assert SequentialConsistency().assess(given).objects.contradicting.tolist()[2] == 2, "b and c, and not d"


@pytest.mark.parametrize("stage", STAGES)
def test_impossible_covariances_cost_no_picture(stage: type[Integrity]) -> None:
    spec = dict(
        type="CommandCenterPipeline",
        clustering=dict(type="SampledAssignmentClusterer"),
        group_tracking=dict(
            type="GroupTrackerWrapper",
            fusion=dict(type="CovarianceIntersectionFusion"),
            tracker=dict(type="KalmanBoxTracker3D"),
        ),
        integrity=dict(type=stage.__name__),
    )
    pipeline: Pipeline = registry.build(spec, Pipeline, "pipeline")
    for frame in range(5):
        given = honest(frame)
        covariance = given.states.covariance.copy()
        covariance[given.agent == 2] = 0.0
        covariance[given.agent == 3] = -np.eye(9) * 0.01
        states = given.states.with_(covariance=covariance)
        picture, _ = pipeline.step(given.time_ns, states, given.agent, given.agents)
    assert len(picture) == len(CARS)


def test_a_flood_of_tracks_costs_a_fault_fit_little() -> None:
    n = 20_000
    flood = ObjectStates.of(
        np.random.default_rng(1).uniform(-200, 200, (n, 3)),
        size=np.tile(CAR, (n, 1)),
        covariance=np.tile(np.eye(9), (n, 1, 1)),
    )
    found = Differences.of(flood, np.arange(n) * 2 // n, np.zeros(2))
    assert len(found.offset) <= 2 * MAX_TRACKS * MAX_NEAR


def test_views_are_limited_in_size_and_all_together() -> None:
    body = view_columns(view((0.0, 0.0)).view, np.ones((1, MAX_CELLS)))
    check_view(body)
    with pytest.raises(ValueError, match=f"free.*{MAX_CELLS + 1} directions"):
        check_view(body | {"free": np.ones((1, MAX_CELLS + 1))})
    whole = MAX_ROWS // MAX_CELLS
    columns = collated_columns([body] * (whole + 3))
    assert len(columns["free"]) <= MAX_ROWS
    assert columns["grid"].tolist() == [[1, MAX_CELLS]] * whole + [[0, 0]] * 3


@pytest.mark.parametrize("judge", [SequentialConsistency, TruthDiscovery])
def test_a_fault_does_not_release_a_liar(judge: type[Integrity]) -> None:
    stage = judge()
    for frame in range(200):
        stage.assess(honest(frame, *TWO))
    stage.excuse("d")
    assert stage.assess(honest(200, *TWO)).agents.state.tolist()[3] == SUSPENDED


def test_many_lies_do_not_delay_the_release_without_end() -> None:
    stage, places = SequentialConsistency(), [(0.0, 0.0), (4.0, -12.0), (-4.0, -12.0), (-12.0, 0.0), (12.0, 0.0)]
    for frame in range(50):
        stage.assess(honest(frame, *(("d", 2 + i, place) for i, place in enumerate(places))))
    states = [stage.assess(honest(frame)).agents for frame in range(50, 50 + 700)]
    assert states[200].state[3] == SUSPENDED
    assert states[-1].state[3] != SUSPENDED
    assert not states[-1].reason[3]


def test_an_agent_without_witnesses_keeps_its_prior_trust() -> None:
    stage = TruthDiscovery()
    for frame in range(0, 3000, 5):
        found = stage.assess(replace(batch([("a", 0, (0.0, 0.0))], ("a",)), time_ns=frame * STEP_NS))
    assert found.agents.log_odds[0] == pytest.approx(3.0, abs=0.01)
