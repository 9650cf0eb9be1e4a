"""The evaluator hears everything and says nothing; what it has heard becomes the metrics of the run."""

from typing import Any

import numpy as np
import pytest
from tiny_world import Bench, Run, picture, states, tiny, tracks

from mast_zenoh.attacks import ACTIONS
from mast_zenoh.errors import ConfigurationError
from mast_zenoh.geometry import quaternion_from_rotation, rotation_from_yaw
from mast_zenoh.links import FATES, WIRES
from mast_zenoh.messages import text
from mast_zenoh.wiring import Wiring

AGENTS = ("ego", "infra_1", "infra_2")
PLACES = ((10.0, 0.0), (20.0, 5.0))


@pytest.fixture(scope="module")
def resolved():
    return tiny("uncoordinated", "n_adversaries=2")


def truth(*places: tuple[float, float]) -> dict[str, np.ndarray]:
    objects = states(*places)
    columns = {name: getattr(objects, name) for name in ("id", "position", "velocity", "size", "yaw", "class_id")}
    return columns | {
        "points": np.full((len(places), 3), 50),
        "agents": text(list(AGENTS)),
        "agent_position": np.zeros((3, 3)),
        "agent_object": np.array([-1, -1, -1]),
    }


def heard(resolved, frames: int, *, at: Any = None, **config: Any) -> Bench:
    """An evaluator that has heard some frames, in which everyone is right, unless `at` (frame, evaluator) says more."""
    evaluator = Bench(resolved, "evaluator", **config)
    for frame in range(frames):
        evaluator.clock(frame)
        evaluator.send("truth", truth(*PLACES), frame)
        for agent in AGENTS:
            evaluator.send("tracks", tracks(*PLACES), frame, subject=agent)
            evaluator.send("mission", tracks(*PLACES), frame, subject=agent)
        evaluator.send("picture", picture(*PLACES), frame)
        if at:
            at(frame, evaluator)
    return evaluator


def metrics(evaluator: Bench) -> dict[str, Any]:
    return evaluator.host.finish()["metrics"]


@pytest.mark.parametrize(
    ("frames", "expected"),
    [(1, [0, 0]), (2, [0, 1]), (31, [0, 30]), (32, [6, 21]), (33, [6, 22]), (150, [6, 139])],
)
def test_the_first_six_and_last_ten_frames_are_not_scored_unless_that_is_more_than_half(
    resolved, frames: int, expected: list[int]
) -> None:
    evaluator = Bench(resolved, "evaluator")
    for frame in range(frames):
        evaluator.clock(frame)
        evaluator.send("truth", truth(), frame)
    assert metrics(evaluator)["scored_frames"] == expected
    assert metrics(evaluator)["frames"] == frames


def test_a_run_that_never_began_has_empty_metrics(resolved) -> None:
    found = metrics(Bench(resolved, "evaluator"))
    assert (found["frames"], found["scored_frames"], found["frames_per_second"]) == (0, [], None)
    assert found["latency_ms"]["sim_to_picture"] == {"p50": None, "p95": None, "p99": None}


def test_frames_that_are_not_scored_do_not_count(resolved) -> None:
    def wrong_at_the_ends(frame: int, evaluator: Bench) -> None:
        if frame < 6 or frame >= 30:
            evaluator.send("picture", picture((60.0, 60.0)), frame)

    found = metrics(heard(resolved, 40, at=wrong_at_the_ends))["agents"]["ego"]["picture"]
    assert (found["fp"]["mean"], found["fn"]["mean"]) == (0.0, 0.0)
    found = metrics(heard(resolved, 40, at=wrong_at_the_ends, skip_first=0, skip_last=0))["agents"]["ego"]["picture"]
    assert (found["fp"]["mean"], found["fn"]["mean"]) == (16 / 40, 32 / 40)


def test_every_agent_is_scored_by_its_own_tracks_its_mission_and_the_picture(resolved) -> None:
    found = metrics(heard(resolved, 3))["agents"]
    assert found.keys() == set(AGENTS)
    for agent in AGENTS:
        assert found[agent].keys() == {"local", "mission", "picture"}
        for estimator in found[agent].values():
            assert (estimator["tp"]["mean"], estimator["fp"]["mean"], estimator["rmse_m"]) == (2.0, 0.0, 0.0)


def test_tracks_of_another_frame_of_reference_are_brought_to_the_world(resolved) -> None:
    def turned(frame: int, evaluator: Bench) -> None:
        reference = {
            "origin": np.array([10.0, -10.0, 0.0]),
            "rotation": quaternion_from_rotation(rotation_from_yaw(np.pi / 2)),
        }
        evaluator.send("tracks", tracks((10.0, 0.0), (15.0, -10.0)) | reference, frame, subject="ego")

    found = metrics(heard(resolved, 3, at=turned))["agents"]["ego"]["local"]
    assert found["tp"]["mean"] == 2.0
    assert found["rmse_m"] == pytest.approx(0.0, abs=1e-9)


def test_latency_is_the_scene_time_between_a_frame_and_its_picture(resolved) -> None:
    evaluator = Bench(resolved, "evaluator")
    for frame in range(6):
        evaluator.clock(frame)
        if frame >= 2:
            evaluator.send("picture", picture(), frame - 2, step=frame)
    assert metrics(evaluator)["latency_ms"]["sim_to_picture"] == {"p50": 200.0, "p95": 200.0, "p99": 200.0}


def test_reports_become_a_table_with_a_row_for_each_change_whatever_order_they_came_in(resolved) -> None:
    def report(*actions: str) -> dict[str, np.ndarray]:
        n = len(actions)
        return {
            "action": np.array([ACTIONS.index(action) for action in actions]),
            "target": np.arange(n),
            "before_position": np.arange(3.0 * n).reshape(n, 3),
            "after_position": np.zeros((n, 3)),
            "velocity": np.ones((n, 3)),
        }

    def said(order: list[tuple[str, int]]) -> dict[str, np.ndarray]:
        evaluator = Bench(resolved, "evaluator")
        evaluator.clock(0)
        for adversary, frame in order:
            body = report("added", "moved") if adversary == "adversary_1" else report("removed")
            evaluator.send("reports", body, frame, subject=adversary, step=0)
        return evaluator.host.finish()["tables"]["attacks"]

    table = said([("adversary_2", 0), ("adversary_1", 1), ("adversary_1", 0)])
    assert table["adversary"].tolist() == ["adversary_1"] * 4 + ["adversary_2"]
    assert table["frame"].tolist() == [0, 0, 1, 1, 0]
    assert table["action"].tolist() == ["added", "moved", "added", "moved", "removed"]
    assert table["before_x"].tolist() == [0.0, 3.0, 0.0, 3.0, 0.0]
    assert table["vz"].tolist() == [1.0] * 5
    again = said([("adversary_1", 0), ("adversary_1", 1), ("adversary_2", 0)])
    assert {name: column.tolist() for name, column in table.items()} == {n: c.tolist() for n, c in again.items()}


@pytest.fixture(scope="module")
def linked():
    def cut(content: dict[str, Any]) -> None:
        content["faults"] = [{"type": "Partition", "at": 0.2, "until": 0.8, "nodes": ["infra_1"]}]

    return tiny(edit=cut)


def report(*rows: tuple[str, int, str]) -> dict[str, np.ndarray]:
    """A link's report: port, frame, fate."""
    n = len(rows)
    return {
        "port": np.array([WIRES.index(port) for port, _, _ in rows], np.uint8),
        "frame": np.array([frame for _, frame, _ in rows], np.int64),
        "seq": np.array([frame for _, frame, _ in rows], np.int64),
        "fate": np.array([FATES.index(fate) for _, _, fate in rows], np.uint8),
        "rule": np.zeros(n, np.int64),
        "delay_s": np.zeros(n),
    }


def blamed(linked, *, at: Any = None, frames: int = 30) -> dict[str, Any]:
    """The ego's picture of a run in which infra_1 alone sees a car that the picture has from frame 15 to 19 not."""
    evaluator = Bench(linked, "evaluator")
    for frame in range(frames):
        evaluator.clock(frame)
        everything = truth(*PLACES, (40.0, 0.0))
        everything["points"][2] = [0, 50, 0]
        evaluator.send("truth", everything, frame)
        for agent in AGENTS:
            if not at or at(frame, agent, evaluator) is not False:
                evaluator.send("tracks", tracks(*PLACES, *[(40.0, 0.0)] * (agent == "infra_1")), frame, subject=agent)
        evaluator.send("picture", picture(*PLACES, *[(40.0, 0.0)] * (not 15 <= frame < 20)), frame)
    return metrics(evaluator)["agents"]["ego"]["picture"]


def test_what_is_missed_while_all_get_through_is_natural(linked) -> None:
    found = blamed(linked)
    assert found["causes"]["fn"] == {"fusion": 5}
    assert found["fn_split"] == {"fault": 0.0, "attack": 0.0, "natural": pytest.approx(5 / 30)}
    assert found["fp_split"] == {"fault": 0.0, "attack": 0.0, "natural": 0.0}


def test_what_a_link_has_dropped_is_the_faults(linked) -> None:
    """Its report of a frame comes with the next one."""

    def dropped(frame: int, agent: str, evaluator: Bench) -> None:
        if agent == "infra_1" and 15 < frame <= 18:
            evaluator.send("link_reports", report(("tracks", frame - 1, "dropped")), frame, subject="link_infra_1")

    assert blamed(linked, at=dropped)["causes"]["fn"] == {"link or fault": 5}


def test_what_a_killed_agent_would_have_seen_is_the_faults_and_until_it_is_back_in_the_picture(linked) -> None:
    def killed(frame: int, agent: str, evaluator: Bench) -> bool | None:
        if agent == "ego" and frame == 12:
            evaluator.left("infra_1", "agent")
        if agent == "ego" and frame == 17:
            evaluator.host.joined("infra_1", "agent")
        return False if agent == "infra_1" and 13 <= frame < 18 else None

    assert blamed(linked, at=killed)["causes"]["fn"] == {"link or fault": 5}


def test_whom_nobody_hears_for_long_is_cut_off_and_for_a_moment_is_late_at_most(linked) -> None:
    def unheard(first: int, last: int) -> Any:
        return lambda frame, agent, evaluator: agent != "infra_1" or not first <= frame <= last

    assert blamed(linked, at=unheard(16, 19))["causes"]["fn"] == {"fusion": 1, "link or fault": 4}
    assert blamed(linked, at=unheard(16, 17))["causes"]["fn"]["occlusion or range"] == 2


def test_reports_of_links_become_a_table_whatever_order_they_came_in(linked) -> None:
    def said(order: list[int]) -> dict[str, list[Any]]:
        evaluator = Bench(linked, "evaluator")
        evaluator.clock(0)
        for frame in order:
            body = report(("tracks", frame - 1, "dropped"), ("picture", frame - 1, "delayed"))
            evaluator.deliver(
                evaluator.key("link_reports", "link_infra_1"),
                evaluator.message(evaluator.key("link_reports", "link_infra_1"), body, frame, seq=frame),
                step=0,
            )
        return {name: column.tolist() for name, column in evaluator.host.finish()["tables"]["links"].items()}

    table = said([1, 2])
    assert table == said([2, 1])
    assert table["agent"] == ["infra_1"] * 4
    assert table["port"] == ["tracks", "picture"] * 2
    assert table["fate"] == ["dropped", "delayed"] * 2
    assert table["frame"] == [0, 0, 1, 1]


def test_a_run_without_links_has_no_such_table_and_nothing_to_blame_on_them(resolved) -> None:
    assert "links" not in heard(resolved, 3).host.finish()["tables"]
    found = Run(tiny()).results["evaluator"]
    assert "link or fault" not in found["tables"]["objects"]["cause"]
    for of_agent in found["metrics"]["agents"].values():
        split = of_agent["picture"]["fn_split"]
        assert split["fault"] == split["attack"] == 0.0
        assert split["natural"] == pytest.approx(of_agent["picture"]["fn"]["mean"])


def test_without_attacks_the_table_is_empty_but_has_its_columns(resolved) -> None:
    table = heard(resolved, 2).host.finish()["tables"]["attacks"]
    assert {len(column) for column in table.values()} == {0}
    assert {"adversary", "frame", "action", "target", "before_x", "after_z", "vy"} <= table.keys()


def test_it_says_nothing() -> None:
    for name in ("baseline", "uncoordinated", "coordinated"):
        assert not Wiring.from_json(tiny(name).wiring).ports("evaluator").outputs


def test_attacks_on_others_do_not_change_an_agents_own_figures() -> None:
    plain, attacked = Run(tiny()), Run(tiny("uncoordinated", "n_adversaries=1", "attack_start_s=0.2"))
    found = [run.results["evaluator"]["metrics"]["agents"] for run in (plain, attacked)]
    assert found[0]["ego"]["local"] == found[1]["ego"]["local"]
    assert found[0]["infra_1"]["local"] != found[1]["infra_1"]["local"]


def test_parameters_that_make_no_sense_are_refused(resolved) -> None:
    with pytest.raises(ConfigurationError, match="skip_first, skip_last: found -1, 10, expected 0 or more"):
        Bench(resolved, "evaluator", skip_first=-1)
