"""Blame of links and faults: objects known only to disconnected agents."""

from itertools import groupby

import numpy as np
import pytest
from metric_worlds import NOTHING, PICTURE, Row, cars, effects, explained, influences, labelled, passage, recorded

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.evaluation.effects import Effects
from mast_zenoh.evaluation.from_effects import stopped_by_links
from mast_zenoh.metrics import CutOff, CutOffObjects, Presence, Record, Scorer, Series
from mast_zenoh.metrics.causes import split

AGENTS = ("ego", "infra_1", "infra_2")
PERIOD_S = 0.1
FRAMES = 60
CUT = slice(20, 40)
#: An object visible to infra_1 alone, and one visible to ego and infra_1.
FAR, BOTH = 1, 2
POINTS = {FAR: (0, 50, 0), BOTH: (50, 50, 0)}
PLACE = {FAR: (40.0, 0.0), BOTH: (0.0, 0.0)}


def some(*ids: int) -> ObjectStates:
    return cars(*(PLACE[id_] for id_ in ids), id=list(ids))


def hidden(frames: range, at: tuple[float, float]) -> list[Row]:
    """Eve removes the object at a position."""
    return [("eve", frame, "removed", 0, at, (0.0, 0.0)) for frame in frames]


def run_of(*, local, picture, truth=lambda f: some(FAR, BOTH), points=POINTS) -> Record:
    """local: (agent, frame) to tracks; picture, truth: frame to objects."""
    objects = [truth(frame) for frame in range(FRAMES)]
    tracks = {Series(agent, "local"): [local(agent, frame) for frame in range(FRAMES)] for agent in AGENTS}
    hits = [np.array([points[int(id_)] for id_ in each.id]).reshape(-1, len(AGENTS)) for each in objects]
    tracks[PICTURE] = [picture(frame) for frame in range(FRAMES)]
    return recorded(objects, tracks, agents=AGENTS, points=hits)


def judged(*, silent, attacks=(), unheard=None, **world):
    """The objects of the ego's picture, with causes."""
    record = run_of(**world)
    table = explained(record, effects(*attacks), cut_off_objects=severed(record, silent, unheard))
    rows = (table["agent"] == "ego") & (table["estimator"] == "picture")
    return {name: column[rows] for name, column in table.items()}


def severed(record: Record, silent: np.ndarray, unheard: np.ndarray | None = None) -> CutOffObjects:
    scores = Scorer().score(record)
    unheard = np.zeros_like(silent) if unheard is None else unheard
    return CutOff().objects(scores, PERIOD_S, silent, unheard)


def cut(agent: str = "infra_1", when: slice = CUT) -> np.ndarray:
    mask = np.zeros((FRAMES, len(AGENTS)), bool)
    mask[when, AGENTS.index(agent)] = True
    return mask


def holds(agent: str, frame: int) -> ObjectStates:
    """All agents track what they see."""
    return some(*(id_ for id_ in (FAR, BOTH) if POINTS[id_][AGENTS.index(agent)]))


def spans(table, kind: str, outcome: str, id_: int | None = None) -> list[tuple[int, int, str]]:
    """First and last frame of each cause of the errors of one kind, in order."""
    rows = (table["kind"] == kind) & (table["outcome"] == outcome) & ((table["id"] == id_) | (id_ is None))
    pairs = sorted(zip(table["frame"][rows].tolist(), table["cause"][rows].tolist(), strict=True))
    groups = [[frame for frame, _ in group] for _, group in groupby(pairs, key=lambda pair: pair[1])]
    causes = [cause for cause, _ in groupby(cause for _, cause in pairs)]
    return [(frames[0], frames[-1], cause) for frames, cause in zip(groups, causes, strict=True)]


def missed(table, id_: int) -> list[tuple[int, int, str]]:
    return spans(table, "truth", "missed", id_)


def without(id_: int):
    """A picture that loses an object for the duration of the cut."""
    return lambda frame: some(*{FAR, BOTH} - {id_}) if CUT.start <= frame < CUT.stop else some(FAR, BOTH)


FAULT, SIGHT = "link or fault", "occlusion or range"
#: An agent that runs without a link during the cut, and one that is killed for its duration.
SILENT, KILLED = dict(silent=cut()), dict(silent=cut(), unheard=cut())


def without_tracks(agent: str, frames: slice = slice(FRAMES)):
    """Tracks of what each agent sees, but one has none for some frames."""
    inside = range(FRAMES)[frames]
    return lambda each, frame: NOTHING if each == agent and frame in inside else holds(each, frame)


def both_from_25(frame: int) -> ObjectStates:
    return some(FAR, BOTH) if frame >= 25 else some(BOTH)


def near_one(*_) -> ObjectStates:
    return some(BOTH)


def far_one_lost(frame: int) -> ObjectStates:
    return some(FAR, BOTH) if frame < CUT.start else some(BOTH)


def local_of_ego(agent: str, frame: int) -> ObjectStates:
    return some(BOTH) if agent == "ego" else NOTHING


BARELY = {FAR: (50, 4, 0), BOTH: (50, 50, 0)}
CASES = {
    "tracked by a disconnected agent alone": (SILENT, holds, without(FAR), FAR, [(20, 39, FAULT)]),
    "tracked by a connected agent too": (SILENT, holds, without(BOTH), BOTH, [(20, 39, "fusion")]),
    "seen but not tracked by another": (SILENT, without_tracks("ego"), without(BOTH), BOTH, [(20, 39, FAULT)]),
    "barely seen by a killed agent": (
        KILLED | dict(points=BARELY), local_of_ego, without(FAR), FAR, [(20, 39, SIGHT)],
    ),
    "seen by the sensor of a killed agent": (
        KILLED, without_tracks("infra_1", CUT), without(FAR), FAR, [(20, 39, FAULT)],
    ),
    "lost by a restarted agent, which needs a second": (
        KILLED, without_tracks("infra_1", slice(CUT.start, FRAMES)), far_one_lost, FAR,
        [(20, 49, FAULT), (50, 59, SIGHT)],
    ),
    "not tracked by a running disconnected agent": (
        SILENT, without_tracks("infra_1"), without(FAR), FAR, [(20, 39, SIGHT)],
    ),
    "new in the view of a killed agent": (
        KILLED | dict(truth=both_from_25), near_one, near_one, FAR,
        [(25, 34, "lag"), (35, 49, FAULT), (50, 59, SIGHT)],
    ),
    "new, but tracked by a disconnected agent": (
        SILENT | dict(truth=both_from_25), holds, near_one, FAR, [(25, 49, FAULT), (50, 59, "fusion")],
    ),
    "missed without a disconnection": (
        dict(silent=cut(when=slice(0, 0))), holds, without(FAR), FAR, [(20, 39, "fusion")],
    ),
}  # fmt: skip


@pytest.mark.parametrize(("world", "local", "picture", "id_", "expected"), CASES.values(), ids=CASES)
def test_an_object_that_only_disconnected_agents_know_is_missed_due_to_the_fault(world, local, picture, id_, expected):
    assert missed(judged(local=local, picture=picture, **world), id_) == expected


@pytest.mark.parametrize(("taken", "cause"), [(FAR, "removed"), (BOTH, "link or fault")])
def test_hiding_during_a_disconnection_is_attributed_to_the_adversary(taken: int, cause: str) -> None:
    attacks = hidden(range(15, 45), PLACE[taken])
    table = judged(local=holds, picture=without(FAR), silent=cut(), attacks=attacks)
    assert missed(table, FAR) == [(20, 39, cause)]
    rows = table["cause"] == "removed"
    assert set(table["by"][rows]) <= {"eve"}


def test_simultaneous_attack_partition_and_natural_errors_are_distinguished() -> None:
    places = {1: (40.0, 0.0), 2: (0.0, 0.0), 3: (-40.0, 0.0), 4: (0.0, 40.0)}
    points = {1: (0, 50, 0), 2: (0, 50, 0), 3: (0, 0, 9), 4: (50, 0, 0)}
    world = cars(*places.values(), id=list(places))

    def local(agent: str, frame: int) -> ObjectStates:
        return {"ego": world.select(np.array([3])), "infra_1": world.select(np.array([0, 1]))}.get(agent, NOTHING)

    table = judged(
        local=local,
        truth=lambda frame: world,
        points=points,
        picture=lambda frame: world if frame < 20 else world.select(np.array([3])) if frame < 40 else world,
        silent=cut(),
        attacks=hidden(range(20, 40), places[2]),
    )
    causes = {1: [(20, 39, FAULT)], 2: [(20, 39, "removed")], 3: [(20, 39, SIGHT)], 4: []}
    assert {id_: missed(table, id_) for id_ in places} == causes
    missing = (table["kind"] == "truth") & (table["outcome"] == "missed")
    counted = dict(zip(*np.unique(table["cause"][missing], return_counts=True), strict=True))
    assert split(counted, FRAMES) == {
        "fault": 20 / FRAMES,
        "attack": 20 / FRAMES,
        "withheld": 0.0,
        "natural": 20 / FRAMES,
    }


def test_own_tracks_of_an_agent_are_never_blamed_on_a_disconnection() -> None:
    """The ego's own misses are never due to the network."""
    record = run_of(local=holds, picture=without(FAR))
    _, table, _, _ = labelled(record, effects(), cut_off_objects=severed(record, cut()))
    own = (table["estimator"] == "local") & (table["cause"] != "")
    assert set(table["cause"][own]) == {"occlusion or range", "lag"}


def drifting(id_: int):
    """The picture's track of an object goes straight on while the object stands."""

    def picture(frame: int) -> ObjectStates:
        away = 0.5 * (min(frame, 45) - CUT.start) if frame >= CUT.start else 0.0
        positions = [(x + (away if each == id_ else 0.0), y) for each, (x, y) in PLACE.items()]
        ids, extra = [FAR, BOTH], frame >= 43
        return cars(*positions, *([PLACE[id_]] if extra else []), id=[*ids, 9][: 2 + extra])

    return picture


@pytest.mark.parametrize(
    ("world", "expected"),
    [
        (dict(picture=drifting(FAR)), [(25, 49, FAULT), (50, 59, "lag")]),
        (dict(picture=drifting(BOTH)), [(25, 59, "lag")]),
        (
            dict(picture=lambda _: some(FAR, BOTH), truth=lambda f: some(FAR, BOTH) if f < 30 else some(BOTH)),
            [(30, 59, "lag")],
        ),
    ],
    ids=["its only source is disconnected until a second after", "another agent reports it", "it outlives its object"],
)
def test_a_drifting_track_whose_only_source_is_disconnected_is_due_to_the_fault(world, expected) -> None:
    table = judged(local=holds, silent=cut(), **world)
    assert [each for each in spans(table, "track", "false") if each[2] in (FAULT, "lag")] == expected


def missing(silent_frames=(), unheard=(), frames: int = 40, **how) -> list[int]:
    masks = [np.isin(np.arange(frames), np.array(each, int))[:, None] for each in (silent_frames, unheard)]
    return np.flatnonzero(CutOff(**how).missing(*masks, PERIOD_S)[:, 0]).tolist()


def test_an_agent_that_misses_a_frame_is_absent_only_then() -> None:
    assert missing([10, 20, 21]) == [10, 20, 21]


def test_an_agent_absent_for_long_needs_a_second_to_return_to_the_picture() -> None:
    assert missing([10, 11, 12]) == list(range(10, 23))
    assert missing([10, 11, 12], useful_age_s=0.3) == [10, 11, 12]
    assert missing([10, 11, 12], recovery_s=0.0) == [10, 11, 12]


def test_a_short_gap_counts_as_late_and_a_long_one_as_silent() -> None:
    assert missing(unheard=[10, 11]) == []
    assert missing(unheard=[10, 11, 12]) == list(range(10, 23))
    assert missing([9], unheard=[38, 39]) == [9]


def gone(*rows: tuple[str, str, int, bool]) -> list[list[int]]:
    presence = Presence()
    for row in rows:
        presence.note(*row)
    return [np.flatnonzero(column).tolist() for column in presence.absent(AGENTS, np.arange(10)).T]


def test_an_agent_is_down_from_leaving_until_joining() -> None:
    assert gone() == [[], [], []]
    up = [(agent, "agent", 0, True) for agent in AGENTS]
    assert gone(*up) == [[], [], []]
    assert gone(*up, ("infra_1", "agent", 3, False), ("infra_1", "agent", 6, True)) == [[], [3, 4, 5], []]
    assert gone(*up, ("infra_1", "agent", 3, False), ("infra_1", "agent", 3, True)) == [[], [], []]
    assert gone(*up, ("infra_2", "agent", 8, False)) == [[], [], [8, 9]]


def test_an_agent_that_joins_later_was_absent_before() -> None:
    assert gone(("infra_1", "agent", 4, True)) == [[], [0, 1, 2, 3], []]


@pytest.mark.parametrize("role", ["broker", "command_center"])
def test_without_a_command_centre_no_agent_is_connected(role: str) -> None:
    assert gone((role, role, 0, True), (role, role, 7, False)) == [[7, 8, 9]] * 3
    assert gone(("evaluator_2", "evaluator", 0, True), ("evaluator_2", "evaluator", 7, False)) == [[], [], []]


def on_links(*rows: tuple[str, str, int, str]) -> Effects:
    """Effects of links on messages: agent, port, frame, effect."""
    ways = list(dict.fromkeys((agent, port) for agent, port, _, _ in rows))
    return effects(
        *((f"link_{agent}", frame, effect, -1, (0.0, 0.0), (0.0, 0.0)) for agent, _, frame, effect in rows),
        passages=[passage(f"link_{agent}", port, agent) for agent, port in ways],
        of=[ways.index((agent, port)) for agent, port, _, _ in rows],
    )


def test_dropped_damaged_or_late_tracks_and_batches_count_as_disconnected() -> None:
    disconnected = on_links(
        ("infra_1", "tracks", 1, "dropped"),
        ("infra_1", "tracks", 2, "delayed"),
        ("infra_1", "tracks", 3, "corrupted"),
        ("infra_1", "tracks", 4, "repeated"),
        ("infra_1", "tracks", 5, "reframed"),
        ("infra_1", "status", 6, "dropped"),
        ("infra_1", "picture", 7, "dropped"),
        ("infra_2", "tracks", 8, "dropped"),
        ("nobody", "tracks", 9, "dropped"),
        ("centre", "collated", 10, "dropped"),
    )
    roles = {way.node: "link" for way in disconnected.passages}
    known = influences(AGENTS)
    mask = stopped_by_links(disconnected, roles, AGENTS, np.arange(12), known)
    assert [np.flatnonzero(column).tolist() for column in mask.T] == [[10], [1, 2, 3, 10], [8, 10]]
    assert not stopped_by_links(disconnected, {}, AGENTS, np.arange(12), known).any(), (
        "an adversary's drop is not a fault"
    )


def test_objects_are_looked_up_by_frame_and_id() -> None:
    severed = CutOffObjects(np.array([1, 2]), np.array([5, 5]), np.array([True, False]))
    ids, frames = np.array([1, 2, 1, 3]), np.array([5, 5, 6, 5])
    assert severed.contains(ids, frames).tolist() == [True, True, False, False]
    assert severed.contains(ids, frames, tracked=np.array([True] * 4)).tolist() == [True, False, False, False]
    assert not CutOffObjects.nothing().contains(ids, frames, tracked=np.array([True] * 4)).any()
