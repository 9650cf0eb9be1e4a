"""Blame of links and faults: objects known only to disconnected agents."""

from __future__ import annotations

import numpy as np
import pytest
from metric_worlds import Row, cars, effects, explained, labelled, passage

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.effects import Effects
from mast_zenoh.evaluation.from_effects import stopped_by_links
from mast_zenoh.metrics import CutOff, CutOffObjects, Presence, Record, Scorer, Series
from mast_zenoh.metrics.causes import split
from mast_zenoh.metrics.record import Snapshot

AGENTS = ("ego", "infra_1", "infra_2")
PERIOD_S = 0.1
FRAMES = 60
CUT = slice(20, 40)
NOTHING = ObjectStates.empty()
#: An object visible to infra_1 alone, and one visible to ego and infra_1.
FAR, BOTH = 1, 2
POINTS = {FAR: (0, 50, 0), BOTH: (50, 50, 0)}
PLACE = {FAR: (40.0, 0.0), BOTH: (0.0, 0.0)}


def some(*ids: int) -> ObjectStates:
    return cars(*(PLACE[id_] for id_ in ids), id=list(ids))


def hidden(frames: range, at: tuple[float, float]) -> list[Row]:
    """Eve removes the object at a position."""
    return [("eve", frame, "removed", 0, at, (0.0, 0.0)) for frame in frames]


def recorded(*, local, picture, truth=lambda f: some(FAR, BOTH), points=POINTS) -> Record:
    """local: (agent, frame) to tracks; picture, truth: frame to objects."""
    record = Record(AGENTS)
    for frame in range(FRAMES):
        there = truth(frame)
        hits = np.array([points[int(id_)] for id_ in there.id], np.int32).reshape(-1, len(AGENTS))
        record.add_truth(frame, there, hits, np.zeros((3, 3)), np.full(3, -1))
        record.add(frame, [Series("", "picture")], Snapshot.of(picture(frame)))
        for agent in AGENTS:
            record.add(frame, [Series(agent, "local")], Snapshot.of(local(agent, frame)))
    return record


def judged(*, silent, attacks=(), unheard=None, **world):
    """The objects of the ego's picture, with causes."""
    record = recorded(**world)
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


def missed(table, id_: int) -> dict[int, str]:
    """By frame, the cause of a missed object."""
    rows = (table["kind"] == "truth") & (table["outcome"] == "missed") & (table["id"] == id_)
    return dict(zip(table["frame"][rows].tolist(), table["cause"][rows].tolist(), strict=True))


def without(id_: int):
    """A picture that loses an object for the duration of the cut."""
    return lambda frame: some(*{FAR, BOTH} - {id_}) if CUT.start <= frame < CUT.stop else some(FAR, BOTH)


def test_an_object_tracked_only_by_a_disconnected_agent_is_missed_due_to_the_fault() -> None:
    table = judged(local=holds, picture=without(FAR), silent=cut())
    assert missed(table, FAR) == dict.fromkeys(range(20, 40), "link or fault")


def test_an_object_tracked_by_a_connected_agent_is_not_due_to_the_fault() -> None:
    table = judged(local=holds, picture=without(BOTH), silent=cut())
    assert set(missed(table, BOTH).values()) == {"fusion"}


def test_an_object_seen_but_not_tracked_by_another_agent_is_missed_due_to_the_fault() -> None:
    def local(agent: str, frame: int) -> ObjectStates:
        return NOTHING if agent == "ego" else holds(agent, frame)

    table = judged(local=local, picture=without(BOTH), silent=cut())
    assert set(missed(table, BOTH).values()) == {"link or fault"}


def test_an_object_barely_seen_by_a_killed_agent_is_a_natural_miss() -> None:
    def local(agent: str, frame: int) -> ObjectStates:
        return some(BOTH) if agent == "ego" else NOTHING

    points = {FAR: (50, 4, 0), BOTH: (50, 50, 0)}
    table = judged(local=local, picture=without(FAR), silent=cut(), unheard=cut(), points=points)
    assert set(missed(table, FAR).values()) == {"occlusion or range"}


def test_a_killed_agent_is_judged_by_what_its_sensor_would_have_seen() -> None:
    def local(agent: str, frame: int) -> ObjectStates:
        return NOTHING if agent == "infra_1" and CUT.start <= frame < CUT.stop else holds(agent, frame)

    table = judged(local=local, picture=without(FAR), silent=cut(), unheard=cut())
    assert missed(table, FAR) == dict.fromkeys(range(20, 40), "link or fault")


def test_a_restarted_agent_needs_a_second_to_track_objects() -> None:
    def local(agent: str, frame: int) -> ObjectStates:
        return NOTHING if agent == "infra_1" and frame >= CUT.start else holds(agent, frame)

    def picture(frame: int) -> ObjectStates:
        return some(FAR, BOTH) if frame < CUT.start else some(BOTH)

    misses = missed(judged(local=local, picture=picture, silent=cut(), unheard=cut()), FAR)
    assert {misses[frame] for frame in range(20, 50)} == {"link or fault"}
    assert {misses[frame] for frame in range(50, FRAMES)} == {"occlusion or range"}


def test_a_running_disconnected_agent_knows_only_the_objects_it_tracks() -> None:
    def local(agent: str, frame: int) -> ObjectStates:
        return NOTHING if agent == "infra_1" else holds(agent, frame)

    misses = missed(judged(local=local, picture=without(FAR), silent=cut()), FAR)
    assert set(misses.values()) == {"occlusion or range"}


def test_an_object_new_in_the_view_of_a_killed_agent_is_at_first_missed_because_of_lag() -> None:
    def truth(frame: int) -> ObjectStates:
        return some(FAR, BOTH) if frame >= 25 else some(BOTH)

    table = judged(
        local=lambda a, f: some(BOTH), truth=truth, picture=lambda f: some(BOTH), silent=cut(), unheard=cut()
    )
    assert [missed(table, FAR)[frame] for frame in (25, 34, 35, 39)] == ["lag", "lag", "link or fault", "link or fault"]


def test_an_object_already_tracked_by_a_disconnected_agent_is_missed_because_of_the_fault() -> None:
    def truth(frame: int) -> ObjectStates:
        return some(FAR, BOTH) if frame >= 25 else some(BOTH)

    table = judged(local=holds, truth=truth, picture=lambda f: some(BOTH), silent=cut())
    assert {missed(table, FAR)[frame] for frame in range(25, 40)} == {"link or fault"}


@pytest.mark.parametrize(("taken", "cause"), [(FAR, "removed"), (BOTH, "link or fault")])
def test_hiding_during_a_disconnection_is_attributed_to_the_adversary(taken: int, cause: str) -> None:
    attacks = hidden(range(15, 45), PLACE[taken])
    table = judged(local=holds, picture=without(FAR), silent=cut(), attacks=attacks)
    assert set(missed(table, FAR).values()) == {cause}
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
    causes_by_id = {id_: set(missed(table, id_).values()) for id_ in places}
    assert causes_by_id == {1: {"link or fault"}, 2: {"removed"}, 3: {"occlusion or range"}, 4: set()}
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
    record = recorded(local=holds, picture=without(FAR))
    _, table, _, _ = labelled(record, effects(), cut_off_objects=severed(record, cut()))
    own = (table["estimator"] == "local") & (table["cause"] != "")
    assert set(table["cause"][own]) == {"occlusion or range", "lag"}


def test_without_a_disconnection_nothing_is_due_to_a_fault() -> None:
    table = judged(local=holds, picture=without(FAR), silent=cut(when=slice(0, 0)))
    assert "link or fault" not in table["cause"]
    assert set(missed(table, FAR).values()) == {"fusion"}


def drifting(id_: int):
    """The picture's track of an object goes straight on while the object stands."""

    def picture(frame: int) -> ObjectStates:
        away = 0.5 * (min(frame, 45) - CUT.start) if frame >= CUT.start else 0.0
        positions = [(x + (away if each == id_ else 0.0), y) for each, (x, y) in PLACE.items()]
        ids, extra = [FAR, BOTH], frame >= 43
        return cars(*positions, *([PLACE[id_]] if extra else []), id=[*ids, 9][: 2 + extra])

    return picture


def false(table) -> dict[int, str]:
    rows = (table["kind"] == "track") & (table["outcome"] == "false")
    return dict(zip(table["frame"][rows].tolist(), table["cause"][rows].tolist(), strict=True))


def test_a_drifting_track_whose_only_source_is_disconnected_is_due_to_the_fault() -> None:
    """It leaves its object at frame 25; the agent returns at 40, effective 1 s later."""
    false_tracks = false(judged(local=holds, picture=drifting(FAR), silent=cut()))
    assert {false_tracks[frame] for frame in range(25, 50)} == {"link or fault"}
    assert false_tracks[50] == "lag"


def test_a_drifting_track_of_an_object_reported_by_another_agent_is_not_due_to_the_fault() -> None:
    false_tracks = false(judged(local=holds, picture=drifting(BOTH), silent=cut()))
    assert {false_tracks[frame] for frame in range(25, 40)} == {"lag"}


def test_a_track_that_outlives_its_object_is_not_due_to_the_fault_for_a_while() -> None:
    def truth(frame: int) -> ObjectStates:
        return some(FAR, BOTH) if frame < 30 else some(BOTH)

    false_tracks = false(judged(local=holds, truth=truth, picture=lambda f: some(FAR, BOTH), silent=cut()))
    assert {false_tracks[frame] for frame in range(30, 40)} == {"lag"}


# -- absent agents, by frame ------------------------------------------------------------------------------------------


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
    mask = stopped_by_links(disconnected, roles, AGENTS, np.arange(12))
    assert [np.flatnonzero(column).tolist() for column in mask.T] == [[10], [1, 2, 3, 10], [8, 10]]
    assert not stopped_by_links(disconnected, {}, AGENTS, np.arange(12)).any(), "an adversary's drop is not a fault"


def test_objects_are_looked_up_by_frame_and_id() -> None:
    severed = CutOffObjects(np.array([1, 2]), np.array([5, 5]), np.array([True, False]))
    ids, frames = np.array([1, 2, 1, 3]), np.array([5, 5, 6, 5])
    assert severed.contains(ids, frames).tolist() == [True, True, False, False]
    assert severed.contains(ids, frames, tracked=np.array([True] * 4)).tolist() == [True, False, False, False]
    assert not CutOffObjects.nothing().contains(ids, frames, tracked=np.array([True] * 4)).any()


def test_without_frames_there_is_no_split_by_cause() -> None:
    assert split({}, 0) == {"fault": None, "attack": None, "withheld": None, "natural": None}
