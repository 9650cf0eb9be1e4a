"""A finished run reports late, rejected and foreign messages, and overconfident estimates, in one line each."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ros2_worlds import with_ros2
from tiny_world import tiny

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control import results
from mast_zenoh.errors import StallError
from mast_zenoh.launch import ending, notices, run
from mast_zenoh.report.html import write_report
from mast_zenoh.tracking import Innovations
from mast_zenoh.wiring.model import Endpoint, Leg, Wire, Wiring


@pytest.fixture(scope="module")
def world() -> Resolved:
    return tiny()


def commanded() -> tuple[Wiring, dict[str, int]]:
    """The wire of the ego's commands with an adversary and a link on it, and what the world rejected on its keys."""
    driver, liar, link, world = (Endpoint(name, "command") for name in ("driver_ego", "liar", "link_ego", "simulator"))
    legs = Leg("tap/0", driver, (liar,)), Leg("tap/1", liar, (link,)), Leg("agent/ego/command", link, (world,))
    rejected = {"agent/ego/command: body": 4, "agent/ego/command: old": 1, "agent/ego/pose: body": 7, "tap/0: body": 9}
    return Wiring((Wire("agent/ego/command", "ego", "command", legs),)), rejected


COMMANDED = commanded()


def texts(resolved: Resolved, nodes: dict[str, Any] | None = None, **more: Any) -> dict[str, str]:
    """The notices of a synthetic run: kind to text."""
    record = {
        "nodes": nodes or {},
        "invalid_control": more.get("invalid_control", {}),
        "timings": {"frames_per_second": more.get("speed", 10.0)},
    }
    measured = {"late": more.get("late", {})} | more.get("measured", {})
    collations, refused = more.get("collations", []), more.get("refused", [])
    all_notices = notices.of_run(resolved, record, collations, measured, refused, more.get("left_out", {}))
    assert all(notice["count"] > 0 for notice in all_notices)
    return {notice["kind"]: notice["text"] for notice in all_notices}


def test_the_notice_of_tracks_left_out_names_their_agents(world: Resolved) -> None:
    text = texts(world, left_out={"infra_1": 20_000, "ego": 0})["left_out"]
    assert "infra_1: 20000" in text
    assert "input_limit" in text


def test_a_car_without_new_commands_has_a_notice_and_an_obedient_one_has_none() -> None:
    counts = dict(commanded=100, held=3, braked=2, refused=1)
    obedient = dict(commanded=105, held=0, braked=0, refused=0)
    (notice,) = notices.of_commands({"ego": counts, "mobile_1": obedient}, *COMMANDED)
    assert (notice["kind"], notice["count"]) == ("commands", 5)
    assert notice["text"] == (
        "the car of ego had no new command in 5 frames: it went on in 3 and braked in 2; 5 commands refused"
    )
    for invalid in (None, [], "ego", {"ego": None}, {"ego": {"held": -1, "braked": "many"}}):
        assert notices.of_commands(invalid, *COMMANDED) == []


def test_drivers_without_an_estimate_have_a_notice() -> None:
    happened = {"ego": {"blind_frames": 12, "brakes": []}, "mobile_1": {"blind_frames": 0}}
    (notice,) = notices.of_estimates(happened, 150)
    assert (notice["kind"], notice["count"]) == ("estimates", 12)
    assert notice["text"].startswith("driver_ego drove 12 of 150 frames without an estimate")
    for invalid in (None, [], {"ego": None}, {"ego": {"blind_frames": "many"}}):
        assert notices.of_estimates(invalid, None) == []


def test_brakes_that_are_not_judged_by_their_driver_have_a_notice_that_says_why() -> None:
    brakes = [{"on_truth_mps2": None}, {"on_truth_mps2": 0.0}, {}]
    happened = {"ego": {"brakes": brakes, "on_truth_problem": "ValueError: no road"}, "mobile_1": {"brakes": []}}
    (notice,) = notices.of_brakes(happened)
    assert (notice["kind"], notice["count"]) == ("brakes", 1)
    assert notice["text"].startswith("1 brake of ego judged by the intelligent driver model, not by what its driver")
    assert notice["text"].endswith("ValueError: no road")
    for invalid in (None, [], {"ego": None}, {"ego": {"brakes": "many"}}, {"ego": {"brakes": [None]}}):
        assert notices.of_brakes(invalid) == []


def node(**counted: Any) -> dict[str, Any]:
    return {"rejected": {}, "first_rejected": {}, "foreign": {}} | counted


def realtime(world: Resolved, p99: float | None, speed: float = 10.0, **more: Any) -> str:
    """The notice on how a 10 Hz real-time run kept pace; "" for none."""
    measured = {"latency_ms": {"sim_to_picture": {"p99": p99}}}
    return texts(replace(world, mode="realtime"), measured=measured, speed=speed, **more).get("behind", "")


def outside(world: Resolved, *, handed_in: bool = True, **told: Any) -> str:
    """The notice on a node that returned these counts of what came from outside, if it handed in any."""
    nodes = with_ros2("agent", "tcp/127.0.0.1:7447").nodes
    counts = results.outside({"infra_1": {"outside": told}} if handed_in else {}, nodes)
    record = {"nodes": {}, "invalid_control": {}, "outside": counts}
    measured: dict[str, Any] = {"late": {}}
    (notice,) = notices.of_run(world, record, [], measured, [], {})
    return str(notice["text"]).partition("results depend: ")[2]


def test_the_notice_of_a_program_outside_tells_of_interrupted_waits_and_of_second_publishers(world: Resolved) -> None:
    assert outside(world) == "it was sent no message"
    assert outside(world, interrupted=1) == "1 message had no answer yet when the run was stopped"
    several = outside(world, asked=3, answered=3, publishers={"/a": 2, "/b": 1})
    assert several == (
        "it answered each of 3 messages; 2 publishers sent on /a, expected one: any of them may have answered"
    )
    assert "16 or more publishers sent on /a" in outside(world, asked=3, answered=3, publishers={"/a": 16})


def test_a_lost_node_is_not_said_to_have_been_sent_no_message(world: Resolved) -> None:
    assert outside(world, handed_in=False) == "it was lost, and nobody counted its answers"


def test_an_uneventful_run_has_no_notices(world: Resolved) -> None:
    counted = {"late": {}, "overflowed": 0, "absurd": 0, "complete": 12}
    assert texts(world, {"ego": node(), "dead": {"rejected": None}}, collations=[counted]) == {}


def test_the_notice_of_late_messages_names_the_worst_agent(world: Resolved) -> None:
    late = {"ego": 2, "infra_1": 0, "infra_2": 40}
    assert (
        texts(world, late=late)["late"] == "42 messages of 2 agents came too late for their batch (most: infra_2, 40)"
    )
    assert texts(world, late={"ego": 1})["late"] == "1 message of ego came too late for their batch"


def test_messages_left_out_by_a_broker_have_a_notice_per_reason(world: Resolved) -> None:
    notice_texts = texts(world, collations=[{"overflowed": 3, "duplicates": 0, "absurd": 5}, {"overflowed": 1}])
    assert notice_texts.keys() == {"overflowed", "absurd"}
    assert notice_texts["overflowed"].startswith("4 messages dropped")


def test_a_message_rejected_by_several_nodes_counts_once_and_the_first_is_quoted(world: Resolved) -> None:
    heard = {"agent/a/tracks: tracks": 10, "agent/a/tracks: other": 5, "cc/picture: picture": 2}
    first = {"agent/a/tracks": [7, "tracks: not [MessagePack]"], "cc/picture": [3, "picture: truncated"]}
    nodes = {
        "broker": node(rejected={"agent/a/tracks: tracks": 15}, first_rejected={"agent/a/tracks": [7, "tracks: x"]}),
        "evaluator": node(rejected=heard, first_rejected=first),
    }
    notice_texts = texts(world, nodes)["rejected"]
    assert notice_texts == "17 messages on 2 keys (first, by evaluator: cc/picture: picture: truncated)"


def test_the_notice_of_foreign_messages_names_their_keys(world: Resolved) -> None:
    heard = {f"agent/{name}/tracks": 2 for name in "abcde"}
    nodes = {"broker": node(foreign=heard), "evaluator": node(foreign={"agent/a/tracks": 3})}
    notice_texts = texts(world, nodes)["foreign"]
    where = "agent/a/tracks, agent/b/tracks, agent/c/tracks and 2 more"
    assert notice_texts == f"11 messages without the mark of this run's nodes, on {where}"


def test_the_notice_of_refused_control_messages_names_the_worst_key_and_the_reason(world: Resolved) -> None:
    """Broadcasts are counted by every node: the highest count is used."""
    nodes = {
        "ego": node(invalid_control={"epoch": [3, "epoch: not MessagePack"]}),
        "broker": node(invalid_control={"epoch": [2, "epoch: not MessagePack"]}),
        "dead": node(invalid_control=None),
    }
    notice_texts = texts(
        world, nodes, invalid_control={"result/ego": [4, "result: it has handed in its results before"]}
    )
    assert notice_texts["control"] == (
        "4 invalid control messages refused on 1 key "
        "(most: result/ego, 4, the first: result: it has handed in its results before); "
        "nodes report 3 invalid control messages on 1 key (most: epoch, 3 by ego, the first: epoch: not MessagePack)"
    )


def test_a_real_time_run_that_keeps_up_has_no_notice(world: Resolved) -> None:
    assert realtime(world, 25.0) == ""
    assert realtime(world, None) == ""
    assert realtime(world, 199.0) == "", "the broker waits for a silent agent until the next clock"


def test_a_real_time_run_that_does_not_keep_up_explains_why_and_what_to_do(world: Resolved) -> None:
    notice_texts = realtime(world, 2800.0, speed=7.0, late={"ego": 102})
    for part in ("2800 ms", "a frame lasts 100 ms", "7.0 frames/s instead of 10.0", "102 messages came too late"):
        assert part in notice_texts
    for advice in ("lower --rate", "more cores", "latency_s or patience"):
        assert advice in notice_texts


def test_the_latency_limit_depends_on_the_broker_and_the_rate(world: Resolved) -> None:
    nodes = world.nodes | {"broker": replace(world.nodes["broker"], config={"latency_s": 0.3, "patience": 1})}
    patient = replace(world, nodes=nodes)
    assert realtime(patient, 499.0) == ""
    assert "501 ms" in realtime(patient, 501.0)
    assert "a frame lasts 50 ms" in realtime(replace(world, rate=2.0), 199.0, speed=20.0)


def test_late_messages_after_a_delaying_link_are_not_an_overload(world: Resolved) -> None:
    linked = replace(world, timeline=({"kind": "link", "label": "wireless", "at_s": 0.0},))
    assert realtime(linked, 25.0, late={"ego": 3}) == ""
    assert "3 messages" in realtime(world, 25.0, late={"ego": 3})


def test_notices_are_in_run_json_and_in_the_report(tmp_path: Path) -> None:
    def slow_and_corrupt(content: dict[str, Any]) -> None:
        corrupt = dict(type="Corrupt", probability=1.0, flips=20)
        content["links"] = {"infra_1": dict(up=[dict(type="Delay", mean_s=0.25)]), "infra_2": dict(up=[corrupt])}
        content["links"]["*"] = dict(up=[])

    outcome = run.run(tiny(edit=slow_and_corrupt), tmp_path / "run", runtime="inproc")
    assert outcome.error is None
    notices_by_kind = {
        notice["kind"]: notice for notice in json.loads((outcome.folder / "run.json").read_text())["notices"]
    }
    assert notices_by_kind["late"]["text"] == "10 messages of infra_1 came too late for their batch"
    measured = json.loads((outcome.folder / "metrics.json").read_text())
    assert measured["late"] == {"infra_1": 10}, "two of 12 are still in transit at the end"
    assert (outcome.folder / "checks.json").is_file()
    assert notices_by_kind["rejected"]["text"].startswith(f"{notices_by_kind['rejected']['count']} messages on ")
    page = write_report(outcome.folder).read_text()
    assert "late: 10 messages of infra_1 came too late for their batch" in page
    assert "messages on" in page


@pytest.mark.parametrize(("frames", "expected"), [(1, "the only frame is"), (5, "all 5 frames are"), (40, "")])
def test_a_run_too_short_to_leave_out_its_first_frames_has_a_notice(tmp_path: Path, frames: int, expected: str) -> None:
    file, content = scenario.load("baseline", ["n_infrastructure=1"])
    outcome = run.run(scenario.resolve(file, content, frames=frames), tmp_path / "run", runtime="inproc")
    notices_by_kind = {notice["kind"]: notice["text"] for notice in outcome.record["notices"]}
    measured = json.loads((outcome.folder / "metrics.json").read_text())
    assert (measured["settled"], measured["late"]) == (not expected, {})
    assert not (outcome.folder / "checks.json").exists(), "nothing to check without faults"
    assert ("unsettled" in notices_by_kind) == bool(expected)
    assert expected in notices_by_kind.get("unsettled", "")


def test_a_stall_error_names_the_refused_messages() -> None:
    refused = {"kind": "rejected", "count": 7, "text": "7 messages on 1 key (first: agent/x/mission: queued: …)"}
    stall = StallError("stall: evaluator has handled 4 of 5 messages")
    assert str(ending.of_stall(stall, [refused])) == f"{stall}; refused: {refused['text']}"
    assert str(ending.of_stall(stall, [refused | {"kind": "foreign"}])) == str(stall)


def test_frames_that_the_evaluator_missed_are_reported() -> None:
    (notice,) = notices.of_scores({"frames": 936}, 1000)
    assert notice["text"] == "64 frames of 1000 were played and not measured: the evaluator missed them"
    assert notices.of_scores({"frames": 1000}, 1000) == []
    assert notices.of_scores({"frames": 1000}) == []


# -- confidence ------------------------------------------------------------------------------------------------------

SURE, FINE = "overconfident", None


def compared(position: str | None, velocity: str | None, nees: float = 19.2) -> dict[str, Any]:
    """An estimate with these verdicts."""
    numbers = {"nees": nees, "factor": math.sqrt(nees / 2), "pairs": 100}
    return {"position": numbers | {"verdict": position}, "velocity": numbers | {"verdict": velocity}}


def confidence_texts(consistency: object, **trackers: Innovations) -> list[str]:
    summaries = {name: each.summary() for name, each in trackers.items()}
    found = notices.of_confidence({"consistency": consistency}, summaries)
    assert all((each["kind"], each["count"]) == ("confidence", 1) for each in found)
    return [each["text"] for each in found]


def test_the_notice_names_the_agent_the_factor_and_the_nees() -> None:
    assert confidence_texts({"infra_2": {"local": compared(SURE, FINE)}}) == [
        "infra_2 is 3.1 times more confident than accurate (NEES 19.2, expected 2)"
    ]
    assert confidence_texts({"infra_2": {"local": compared(FINE, SURE)}}) == [
        "infra_2 is 3.1 times more confident than accurate in velocity (NEES 19.2, expected 2)"
    ]
    assert confidence_texts({"infra_2": {"local": compared(SURE, SURE, 2e6)}}) == [
        "infra_2 is 1e+03 times more confident than accurate (NEES 2e+06, expected 2), "
        "and 1e+03 times in velocity (NEES 2e+06, expected 2)"
    ]


def test_each_estimate_has_its_own_line() -> None:
    sure = compared(SURE, FINE)
    lines = confidence_texts({"ego": {"received": sure, "picture": sure, "mission": sure}, "infra_1": {"local": sure}})
    subjects = [line.partition(" is ")[0] for line in lines]
    assert subjects == ["ego as received", "the picture", "the mission estimate of ego", "infra_1"]


def test_accurate_and_cautious_estimates_have_no_line() -> None:
    assert (
        confidence_texts({"ego": {"local": compared(FINE, FINE), "picture": compared("overcautious", "overcautious")}})
        == []
    )


def test_many_lines_are_cut_short() -> None:
    lines = confidence_texts({f"infra_{i}": {"local": compared(SURE, FINE)} for i in range(50)})
    assert len(lines) == 21
    assert lines[-1] == "30 more estimates are more confident than accurate"


def test_trackers_are_judged_only_where_nothing_could_be_compared_with_the_truth() -> None:
    sharp = Innovations(700.0, 100, 50)
    nothing = compared(FINE, FINE)
    for summary in nothing.values():
        summary["pairs"] = 0
    assert confidence_texts({"ego": {"local": compared(FINE, FINE)}}, ego=sharp) == []
    assert confidence_texts({"ego": {"local": nothing}}, ego=sharp, infra_1=Innovations(200.0, 100, 0)) == [
        "the tracker of ego is 2.7 times more confident than its measurements bear out (NIS 7.0, expected 2)"
    ]


@pytest.mark.parametrize(
    "returned",
    [None, 7, "text", [], {"ego": None}, {"ego": {"local": 3}}, {"ego": {"local": {"position": {"verdict": SURE}}}}],
)
def test_what_a_users_evaluator_returns_instead_has_no_line(returned: object) -> None:
    assert confidence_texts(returned) == []


def test_only_sound_summaries_of_nodes_with_a_tracker_are_taken(world: Resolved) -> None:
    sound = {"innovations": Innovations(3.0, 2).summary() | {"verdict": SURE, "factor": 1e9}}
    handed_in: dict[str, dict[str, Any]] = {
        "ego": sound,
        "infra_1": {"innovations": {"pairs": -3}},
        "infra_2": {},
        "broker": sound,
        "stranger": sound,
    }
    found = notices.tracker_innovations(handed_in, world.nodes)
    assert found == {"ego": Innovations(3.0, 2).summary()}, "derived values are computed again"


def test_a_tracker_that_reports_nothing_because_all_is_uncertain_has_a_line() -> None:
    lines = confidence_texts({}, infra_1=Innovations(silent=9), infra_2=Innovations(silent=40))
    assert lines == [
        "the tracker of infra_2 reported none of its tracks in 40 steps, as the standard deviation of each was "
        "above max_std_m: raise it if the detections are that noisy"
    ]
