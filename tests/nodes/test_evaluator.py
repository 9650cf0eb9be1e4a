"""The evaluator hears all messages, publishes none, and returns metrics."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from driven import driven
from tiny_world import Bench, picture, pose, states, tiny, tracks

from mast_zenoh.arrays.geometry import quaternion_from_rotation, rotation_from_yaw
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.messages.schemas import text
from mast_zenoh.metrics import ESTIMATORS
from mast_zenoh.wiring.model import Wiring

AGENTS = ("ego", "infra_1", "infra_2")
PLACES = ((10.0, 0.0), (20.0, 5.0))
#: An additional action in a frame: (frame, evaluator).
More = Callable[[int, Bench], Any]


@pytest.fixture(scope="module")
def resolved():
    return tiny("uncoordinated", "n_adversaries=2", acting=True)


def truth(*places: tuple[float, float]) -> dict[str, np.ndarray]:
    objects = states(*places)
    columns = {name: getattr(objects, name) for name in ("id", "position", "velocity", "size", "yaw", "class_id")}
    return columns | {
        "points": np.full((len(places), 3), 50),
        "agents": text(list(AGENTS)),
        "agent_position": np.zeros((3, 3)),
        "agent_object": np.array([-1, -1, -1]),
    }


def heard(resolved, frames: int, *, at: More | None = None, **config: Any) -> Bench:
    """An evaluator after some correct frames, changed by `at` in each."""
    evaluator = Bench(resolved, "evaluator", **config)
    for frame in range(frames):
        evaluator.hear("clock", {}, frame)
        evaluator.hear("scene/truth", truth(*PLACES), frame)
        if at:
            at(frame, evaluator)
        for agent in AGENTS:
            evaluator.hear(f"agent/{agent}/tracks", tracks(*PLACES), frame)
            evaluator.hear(f"agent/{agent}/mission", tracks(*PLACES), frame)
        evaluator.hear("cc/picture", picture(*PLACES), frame)
    return evaluator


def metrics(evaluator: Bench) -> dict[str, Any]:
    return evaluator.host.finish()["metrics"]


@pytest.mark.parametrize(
    ("frames", "expected"), [(1, [0, 0]), (2, [0, 1]), (31, [0, 30]), (32, [6, 21]), (33, [6, 22]), (150, [6, 139])]
)
def test_the_first_six_and_last_ten_frames_are_unscored_unless_more_than_half(resolved, frames, expected) -> None:
    evaluator = Bench(resolved, "evaluator")
    for frame in range(frames):
        evaluator.hear("clock", {}, frame)
        evaluator.hear("scene/truth", truth(), frame)
    scores = metrics(evaluator)
    assert scores["scored_frames"] == expected
    assert scores["frames"] == frames


def test_a_run_without_frames_has_empty_metrics(resolved) -> None:
    scores = metrics(Bench(resolved, "evaluator"))
    assert (scores["frames"], scores["scored_frames"], scores["frames_per_second"]) == (0, [], None)
    assert scores["latency_ms"]["sim_to_picture"] == {"p50": None, "p95": None, "p99": None}


def test_frames_that_are_not_scored_do_not_count(resolved) -> None:
    def wrong_at_the_ends(frame: int, evaluator: Bench) -> None:
        if frame < 6 or frame >= 30:
            evaluator.hear("cc/picture", picture((60.0, 60.0)), frame)

    scores = metrics(heard(resolved, 40, at=wrong_at_the_ends))["agents"]["ego"]["picture"]
    assert (scores["fp"]["mean"], scores["fn"]["mean"]) == (0.0, 0.0)
    scores = metrics(heard(resolved, 40, at=wrong_at_the_ends, skip_first=0, skip_last=0))["agents"]["ego"]["picture"]
    assert (scores["fp"]["mean"], scores["fn"]["mean"]) == (16 / 40, 32 / 40)


def test_every_estimate_of_every_agent_is_scored(resolved) -> None:
    scores = metrics(heard(resolved, 3))
    assert scores["agents"].keys() == set(AGENTS)
    for of_agent in scores["agents"].values():
        assert tuple(of_agent) == ESTIMATORS
        for estimator in of_agent.values():
            assert (estimator["tp"]["mean"], estimator["fp"]["mean"], estimator["rmse_m"]) == (2.0, 0.0, 0.0)
    same = {"received": "local", "picture_received": "picture", "picture_on_arrival": "picture"}
    assert scores["same_as"] == dict.fromkeys(AGENTS, same)


def test_tracks_in_another_frame_of_reference_are_converted_to_the_world_frame(resolved) -> None:
    def turned(frame: int, evaluator: Bench) -> None:
        reference = {
            "origin": np.array([10.0, -10.0, 0.0]),
            "rotation": quaternion_from_rotation(rotation_from_yaw(np.pi / 2)),
        }
        evaluator.hear("agent/ego/tracks", tracks((10.0, 0.0), (15.0, -10.0)) | reference, frame)

    scores = metrics(heard(resolved, 3, at=turned))["agents"]["ego"]["local"]
    assert scores["tp"]["mean"] == 2.0
    assert scores["rmse_m"] == pytest.approx(0.0, abs=1e-9)


def test_latency_is_the_scene_time_between_a_frame_and_its_picture(resolved) -> None:
    evaluator = Bench(resolved, "evaluator")
    for frame in range(6):
        evaluator.hear("clock", {}, frame)
        if frame >= 2:
            evaluator.hear("cc/picture", picture(), frame - 2, step=frame)
    assert metrics(evaluator)["latency_ms"]["sim_to_picture"] == {"p50": 200.0, "p95": 200.0, "p99": 200.0}


def test_a_late_picture_is_scored_for_its_own_frame_and_for_the_frame_of_its_arrival(resolved) -> None:
    """Everything moves 1.5 m per frame; the picture is three frames late."""
    evaluator = Bench(resolved, "evaluator", skip_first=0, skip_last=0)
    for frame in range(20):
        evaluator.hear("clock", {}, frame)
        evaluator.hear("scene/truth", truth((1.5 * frame, 0.0)), frame)
        if frame >= 3:
            evaluator.hear("cc/picture", picture((1.5 * (frame - 3), 0.0)), frame - 3, step=frame)
    scores = metrics(evaluator)["agents"]["ego"]
    assert scores["picture"]["tp"]["mean"] == scores["picture_received"]["tp"]["mean"] == 17 / 20
    assert scores["picture_on_arrival"]["tp"]["mean"] == 0.0
    assert scores["picture_on_arrival"]["fp"]["mean"] == 17 / 20


# -- estimates where they are sent and where they are received ------------------------------------------------------


@pytest.fixture(scope="module")
def intercepted():
    """Adversaries on infra_1's tracks on their way to the broker."""
    return tiny("coordinated", "n_adversaries=1")


def test_own_tracks_are_scored_as_they_were_computed_and_as_the_broker_received_them(intercepted) -> None:
    evaluator = Bench(intercepted, "evaluator")
    for frame in range(3):
        evaluator.hear("clock", {}, frame)
        evaluator.hear("scene/truth", truth(*PLACES), frame)
        evaluator.hear("agent/infra_1/tracks/@tap/0", tracks(*PLACES), frame)
        evaluator.hear("agent/infra_1/tracks", tracks(PLACES[0], (-30.0, 0.0)), frame)
    scores = metrics(evaluator)["agents"]["infra_1"]
    assert [scores[name][what]["mean"] for name in ("local", "received") for what in ("fn", "fp", "tp")] == [
        *(0.0, 0.0, 2.0),
        *(1.0, 1.0, 1.0),
    ]


# -- effects of interposers --------------------------------------------------------------------------------------------


def moved(frame: int, evaluator: Bench) -> None:
    """infra_1's adversary moves the first detection by 3 m."""
    body = {"position": np.array([[5.0, 0.0, 1.0], [9.0, 4.0, 1.0]])}
    body |= {"size": np.array([[4.5, 1.8, 1.6], [4.1, 1.7, 1.5]]), "yaw": np.zeros(2), "score": np.array([0.9, 0.8])}
    body |= {"class_id": np.ones(2, np.uint8), "covariance": np.zeros((2, 3, 3))}
    body |= {"mount_position": np.zeros(3), "mount_rotation": np.array([1.0, 0.0, 0.0, 0.0])}
    evaluator.hear("agent/infra_1/pose", pose(100.0, 0.0, np.pi / 2), frame)
    evaluator.hear("agent/infra_1/detections/@tap/0", body, frame)
    shifted = body["position"] + np.array([[3.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    evaluator.hear("agent/infra_1/detections", body | {"position": shifted}, frame)


def test_unreported_changes_of_an_adversary_are_measured_in_the_world_frame(resolved) -> None:
    evaluator = heard(resolved, 2, at=moved)
    outcome = evaluator.host.finish()
    table = outcome["tables"]["attacks"]
    assert table["effect"].tolist() == ["moved", "moved"]
    assert table["interposer"].tolist() == ["adversary_1"] * 2
    assert table["wire"].tolist() == ["agent/infra_1/detections"] * 2
    assert table["frame"].tolist() == [0, 1]
    before = np.column_stack([table[f"before_{axis}"] for axis in "xyz"])
    after = np.column_stack([table[f"after_{axis}"] for axis in "xyz"])
    assert before == pytest.approx(np.array([[100.0, 5.0, 1.0]] * 2))
    assert after == pytest.approx(np.array([[100.0, 8.0, 1.0]] * 2))
    assert table["columns"].tolist() == ["position"] * 2
    assert not table["reported"].any()
    verdict = outcome["metrics"]["interposers"]["adversary_1"]
    assert (verdict["agreement"], verdict["effects"], verdict["reports"]) == ("silent", {"moved": 2}, 0)


def report(*changes: tuple[int, int, tuple[float, float, float], tuple[float, float, float]]) -> dict[str, np.ndarray]:
    """An adversary's report: action, target, before, after."""
    return {
        "action": np.array([change[0] for change in changes], np.uint8),
        "target": np.array([change[1] for change in changes], np.int64),
        "before_position": np.array([change[2] for change in changes]).reshape(-1, 3),
        "after_position": np.array([change[3] for change in changes]).reshape(-1, 3),
        "velocity": np.zeros((len(changes), 3)),
    }


TRUE = (2, 7, (100.0, 5.0, 1.0), (100.0, 8.0, 1.0))
LIE = (0, 8, (0.0, 0.0, 0.0), (-40.0, 8.0, 1.0))


@pytest.mark.parametrize(
    ("changes", "verdict", "unreported", "unfounded"),
    [((TRUE,), "agrees", 0, 0), ((TRUE, LIE), "disagrees", 0, 2), ((LIE,), "disagrees", 1, 2)],
)
def test_true_reports_become_labels_and_false_ones_contradictions(
    resolved, changes, verdict: str, unreported: int, unfounded: int
) -> None:
    def told(frame: int, evaluator: Bench) -> None:
        moved(frame, evaluator)
        evaluator.hear("attack/adversary_1/report", report(*changes), frame)

    outcome = heard(resolved, 2, at=told).host.finish()
    measured = outcome["metrics"]["interposers"]["adversary_1"]
    assert (measured["agreement"], measured["unreported"], measured["unfounded"]) == (verdict, unreported, unfounded)
    table = outcome["tables"]["attacks"]
    assert table["effect"].tolist() == ["moved"] * 2, "reporting adds no effect"
    assert table["label"].tolist() == ([7, 7] if TRUE in changes else [-1, -1])


def test_without_interposers_the_table_of_effects_is_empty_but_has_its_columns() -> None:
    outcome = heard(tiny(acting=True), 2).host.finish()
    table = outcome["tables"]["attacks"]
    assert {len(column) for column in table.values()} == {0}
    assert {"interposer", "wire", "frame", "effect", "before_x", "after_z", "vy", "reported"} <= table.keys()
    assert outcome["metrics"]["interposers"] == outcome["metrics"]["achieved"] == {}


# -- links and faults --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def linked():
    def cut(content: dict[str, Any]) -> None:
        content["faults"] = [{"type": "Partition", "at": 0.2, "until": 0.8, "nodes": ["infra_1"]}]

    return tiny(edit=cut)


def blamed(linked, *, at: Any = None, passes: Any = None, frames: int = 30, **config: Any) -> dict[str, Any]:
    """The ego's picture, without a car seen only by infra_1 in frames 15 to 19."""
    evaluator = Bench(linked, "evaluator", **config)
    link_out = next(way.sent for way in Wiring.from_json(linked.wiring).passages() if way.port == "tracks")
    for frame in range(frames):
        evaluator.hear("clock", {}, frame)
        everything = truth(*PLACES, (40.0, 0.0))
        everything["points"][2] = [0, 50, 0]
        evaluator.hear("scene/truth", everything, frame)
        for agent in AGENTS:
            if not at or at(frame, agent, evaluator) is not False:
                body = tracks(*PLACES, *[(40.0, 0.0)] * (agent == "infra_1"))
                evaluator.hear(f"agent/{agent}/tracks", body, frame)
                if agent == "infra_1" and (not passes or passes(frame)):
                    evaluator.hear(link_out, body, frame)
        evaluator.hear("cc/picture", picture(*PLACES, *[(40.0, 0.0)] * (not 15 <= frame < 20)), frame)
    return metrics(evaluator)["agents"]["ego"]["picture"]


def killed(frame: int, agent: str, evaluator: Bench) -> bool | None:
    if agent == "ego" and frame == 12:
        evaluator.left("infra_1", "agent")
    if agent == "ego" and frame == 17:
        evaluator.host.joined("infra_1", "agent")
    return False if agent == "infra_1" and 13 <= frame < 18 else None


@pytest.mark.parametrize(
    ("what", "cause", "split"),
    [
        (dict(), "fusion", "natural"),
        (dict(passes=lambda frame: not 15 <= frame < 18), "link or fault", "fault"),
        (dict(at=killed), "link or fault", "fault"),
    ],
    ids=["no loss", "an unreported drop", "a killed agent"],
)
def test_missed_objects_are_due_to_what_was_lost_on_the_wires(linked, what, cause: str, split: str) -> None:
    causes = blamed(linked, **what)
    assert causes["causes"]["fn"] == {cause: 5}
    none = dict.fromkeys(("fault", "attack", "withheld", "natural"), 0.0)
    assert causes["fn_split"] == none | {split: pytest.approx(5 / 30)}
    assert causes["fp_split"] == none


# -- the node ----------------------------------------------------------------------------------------------------------


def test_the_evaluator_subscribes_only_to_what_it_needs() -> None:
    evaluator = Bench(tiny(), "evaluator")
    evaluator.node.on_everything = lambda message, context: pytest.fail(message.key)
    for key in ("agent/ego/pose", "agent/ego/detections", "agent/ego/status", "cc/collated"):
        evaluator.host.deliver(key, b"never looked at", 0)
    assert not evaluator.host.failures


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"skip_first": -1}, r"skip_first, skip_last.*-1"),
        ({"attribution": {"lie_m": -1.0}}, "attribution: AttributionLimits: lie_m"),
        (
            {"attribution": {"lie": 1.0}},
            r"attribution.lie: AttributionLimits.*'lie_m'",
        ),
        ({"attribution": {"coast_s": "4 s"}}, r"attribution.coast_s.*'4 s'"),
        ({"cut_off": {"recovery_s": -1.0}}, "cut_off: CutOff: recovery_s"),
        ({"cut_off": 0.5}, r"cut_off.*0.5.*dict"),
        ({"picture_age_s": -0.1}, r"picture_age_s.*-0.1.*0"),
        ({"driving": {"type": "Driving", "horizon_m": 0.0}}, r"horizon_m.*0.0.*0"),
        ({"metrics": [{"type": "LongestMiss"}, {"type": "LongestMiss"}]}, r"metrics.*'longest_miss' twice"),
    ],
)
def test_invalid_parameters_are_refused(resolved, config: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        Bench(resolved, "evaluator", **config)


@pytest.mark.parametrize("column", ["covariance", "velocity"])
def test_a_driver_is_not_said_to_believe_what_it_drops(column: str) -> None:
    evaluator = Bench(driven(frames=4), "evaluator")
    body = tracks(*PLACES)
    body[column][1] = 2e8
    evaluator.hear("agent/ego/mission", body, 0)
    (arrival,) = evaluator.node.data.heard["ego"].estimates["mission"].values()
    np.testing.assert_array_equal(arrival.objects.id, body["id"][:1])
