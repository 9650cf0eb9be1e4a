"""A finished run reports late, rejected and foreign messages, and overconfident estimates, in one line each."""

import itertools
import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from kept_texts import assert_kept
from ros2_worlds import with_ros2
from tiny_world import tiny

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import RunFolderError, StallError
from mast_zenoh.launch import ending, notices, run
from mast_zenoh.mesh.control import results
from mast_zenoh.run_folder import read_object
from mast_zenoh.run_folder.finding import Finding, sentence
from mast_zenoh.show.html import write_report
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


def texts(resolved: Resolved, nodes: dict[str, Any] | None = None, **more: Any) -> list[str]:
    """The notices of a synthetic run, each with its kind."""
    record = {
        "nodes": nodes or {},
        "invalid_control": more.get("invalid_control", {}),
        "timings": {"frames_per_second": more.get("speed", 10.0)},
    }
    measured = {"late": more.get("late", {})} | more.get("measured", {})
    collations, refused = more.get("collations", []), more.get("refused", [])
    found = notices.of_run(resolved, record, collations, measured, refused, more.get("left_out", {}))
    return [f"{each.kind}: {sentence(each)}" for each in found]


def node(**counted: Any) -> dict[str, Any]:
    return {"rejected": {}, "first_rejected": {}, "foreign": {}} | counted


LISTENING = {
    "broker": node(
        rejected={"agent/a/tracks: tracks": 15},
        first_rejected={"agent/a/tracks": [7, "tracks: x"]},
        foreign={f"agent/{name}/tracks": 2 for name in "abcde"},
        invalid_control={"epoch": [2, "epoch: not MessagePack"]},  # a broadcast, which every node counts
    ),
    "evaluator": node(
        rejected={"agent/a/tracks: tracks": 10, "agent/a/tracks: other": 5, "cc/picture: picture": 2},
        first_rejected={"agent/a/tracks": [7, "tracks: not [MessagePack]"], "cc/picture": [3, "picture: truncated"]},
        foreign={"agent/a/tracks": 3},
        invalid_control={"epoch": [3, "epoch: not MessagePack"]},
    ),
    "dead": node(invalid_control=None, rejected=None),
}
QUIET = {"late": {}, "overflowed": 0, "absurd": 0, "complete": 12}
EVENTS: dict[str, dict[str, Any]] = {
    "nothing": dict(nodes={"ego": node(), "dead": {"rejected": None}}, collations=[QUIET]),
    "tracks left out": dict(left_out={"infra_1": 20_000, "ego": 0}),
    "late messages of two agents": dict(late={"ego": 2, "infra_1": 0, "infra_2": 40}),
    "one late message": dict(late={"ego": 1}),
    "a full broker": dict(collations=[{"overflowed": 3, "duplicates": 0, "absurd": 5}, {"overflowed": 1}]),
    "bad messages": dict(
        nodes=LISTENING, invalid_control={"result/ego": [4, "result: it has handed in its results before"]}
    ),
}


def pace(p99: float | None, **more: Any) -> dict[str, Any]:
    """Events of a 10 Hz run whose last picture of a hundred came p99 ms after its frame."""
    return dict(measured={"latency_ms": {"sim_to_picture": {"p99": p99}}}) | more


def outside(handed_in: bool = True, **told: Any) -> str:
    """The notice on a node that returned these counts of what came from outside, if it handed in any."""
    nodes = with_ros2("agent", "tcp/127.0.0.1:7447").nodes
    counts = results.outside({"infra_1": {"outside": told}} if handed_in else {}, nodes)
    (notice,) = notices.of_run(
        tiny(), {"nodes": {}, "invalid_control": {}, "outside": counts}, [], {"late": {}}, [], {}
    )
    return sentence(notice)


def test_the_words_of_notices(world: Resolved) -> None:
    realtime = replace(world, mode="realtime")
    patient = world.nodes | {"broker": replace(world.nodes["broker"], config={"latency_s": 0.3, "patience": 1})}
    linked = replace(realtime, timeline=({"kind": "link", "label": "wireless", "at_s": 0.0},))
    several = dict(asked=3, answered=3)
    said = {name: texts(world, **events) for name, events in EVENTS.items()}
    said |= {f"in real time, {p99} ms": texts(realtime, **pace(p99)) for p99 in (25.0, None, 199.0)}
    said |= {
        "too slow": texts(realtime, **pace(2800.0, speed=7.0, late={"ego": 102})),
        **{
            f"a patient broker, {p99} ms": texts(replace(realtime, nodes=patient), **pace(p99))
            for p99 in (499.0, 501.0)
        },
        "twice as fast": texts(replace(realtime, rate=2.0), **pace(199.0, speed=20.0)),
        "late behind a link": texts(linked, **pace(25.0, late={"ego": 3})),
        "late without a link": texts(realtime, **pace(25.0, late={"ego": 3})),
    }
    said["programs outside"] = [
        outside(),
        outside(interrupted=1),
        outside(**several, publishers={"/a": 2, "/b": 1}),
        outside(**several, publishers={"/a": 16}),
        outside(handed_in=False),
    ]
    said["confidence"] = [sentence(each) for each in found_of_confidence()]
    lines = [[name, *(f"  {text}" for text in of)] for name, of in said.items()]
    assert_kept("notices", *itertools.chain(*lines))


REFUSED = Finding("count", what="refused", value=5, unit="commands")
COUNTS = dict(commanded=100, held=3, braked=2, refused=1)
OBEDIENT = dict(commanded=105, held=0, braked=0, refused=0)
BRAKES = [{"on_truth_mps2": None}, {"on_truth_mps2": 0.0}, {}]
BLIND = {"ego": {"blind_frames": 12, "brakes": []}, "mobile_1": {"blind_frames": 0}}
UNJUDGED = {"ego": {"brakes": BRAKES, "on_truth_problem": "ValueError: no road"}, "mobile_1": {"brakes": []}}


@pytest.mark.parametrize(
    ("notices_of", "counted", "expected", "words", "invalid"),
    [
        (
            lambda counts: notices.of_commands(counts, *COMMANDED),
            {"ego": COUNTS, "mobile_1": OBEDIENT},
            Finding("commands", ("ego",), "", 5, 2, "frames", parts=(REFUSED,)),
            "the car of ego had no new command in 5 frames: it went on in 3 and braked in 2; 5 commands refused",
            [None, [], "ego", {"ego": None}, {"ego": {"held": -1, "braked": "many"}}],
        ),
        (
            lambda happened: notices.of_estimates(happened, 150),
            BLIND,
            Finding("estimates", ("driver_ego",), "", 12, 150, "frames"),
            "driver_ego drove 12 of 150 frames without an estimate that is new enough (estimate_age_s): it only braked",
            [None, [], {"ego": None}, {"ego": {"blind_frames": "many"}}],
        ),
        (
            notices.of_brakes,
            UNJUDGED,
            Finding("brakes", ("ego",), value=1, unit="brakes", cause=("ValueError: no road",)),
            "1 brake of ego judged by the intelligent driver model, not by what its driver does on the truth: "
            "ValueError: no road",
            [None, [], {"ego": None}, {"ego": {"brakes": "many"}}, {"ego": {"brakes": [None]}}],
        ),
        (
            lambda metrics: notices.of_scores(metrics, 1000),
            {"frames": 936},
            Finding("unmeasured", value=64, other=1000, unit="frames"),
            "64 frames of 1000 were played and not measured: the evaluator missed them",
            [{"frames": 1000}],
        ),
    ],
)
def test_a_notice_on_drivers_or_scores_counts_and_what_is_no_count_has_none(
    notices_of: Any, counted: Any, expected: Finding, words: str, invalid: list[Any]
) -> None:
    assert [*notices_of(counted)] == [expected]
    assert sentence(expected) == words
    assert Finding.from_json(json.loads(json.dumps(expected.to_json()))) == expected
    assert [[*notices_of(each)] for each in invalid] == [[]] * len(invalid)


@pytest.mark.usefixtures("without_figures")
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
    assert (notices_by_kind["late"]["who"], notices_by_kind["late"]["value"]) == (["infra_1"], 10)
    measured = json.loads((outcome.folder / "metrics.json").read_text())
    assert measured["late"] == {"infra_1": 10}, "two of 12 are still in transit at the end"
    assert (outcome.folder / "checks.json").is_file()
    assert notices_by_kind["rejected"]["text"].startswith(f"{notices_by_kind['rejected']['value']} messages on ")
    page = write_report(outcome.folder).read_text()
    assert "infra_1 came too" in page
    assert "messages on" in page
    written = json.loads((outcome.folder / "findings.json").read_text())
    assert notices_by_kind["late"].items() <= {each["kind"]: each for each in written}["late"].items()
    assert [each.kind for each in mast.open(outcome.folder).findings] == [each["kind"] for each in written]


@pytest.mark.parametrize(("frames", "expected"), [(1, [1]), (5, [5]), (40, [])])
def test_a_run_too_short_to_leave_out_its_first_frames_has_a_notice(
    tmp_path: Path, frames: int, expected: list[int]
) -> None:
    file, content = scenario.load("baseline", ["n_infrastructure=1"])
    outcome = run.run(scenario.resolve(file, content, frames=frames), tmp_path / "run", runtime="inproc")
    measured = json.loads((outcome.folder / "metrics.json").read_text())
    assert (measured["settled"], measured["late"]) == (not expected, {})
    assert not (outcome.folder / "checks.json").exists(), "nothing to check without faults"
    assert [each["value"] for each in outcome.record["notices"] if each["kind"] == "unsettled"] == expected


@pytest.mark.parametrize(
    ("damage", "place"),
    [
        (None, "notices[0].kind"),
        ({"kind": "late"}, "notices[0].text"),
        ({"kind": "late", "text": "late", "who": [None]}, "notices[0].who"),
        ({"kind": "late", "text": "late", "when": [1.0]}, "notices[0].when"),
        ({"kind": "late", "text": "late", "value": math.nan}, "notices[0].value"),
        ({"kind": "late", "text": "late", "when": [0.0, math.inf]}, "notices[0].when[1]"),
        ({"kind": "late", "text": "late", "parts": [{"who": []}]}, "notices[0].parts[0].kind"),
    ],
)
def test_a_damaged_notice_is_refused_with_its_file_and_field(
    tmp_path: Path, damage: dict[str, Any] | None, place: str
) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"notices": [damage]}))
    with pytest.raises(RunFolderError) as refusal:
        read_object(tmp_path / "run.json")
    assert f"run.json: cannot be read: {place}: " in str(refusal.value)


def test_a_notice_of_an_older_version_has_its_count_as_value() -> None:
    assert Finding.from_json({"kind": "late", "count": 7, "text": "7 messages", "who": None}) == Finding(
        "late", value=7
    )


def test_a_finding_of_a_newer_version_is_said_by_its_fields() -> None:
    newer = Finding("storm", ("ego", "infra_1"), "hail", 3, 4.5, "m", "the road", (0.0, 2.5), ("ice", "wind"))
    assert sentence(newer) == "hail ego and infra_1 the road: 3 of 4.5 m from 0 to 2.5 s (ice; wind)"
    assert sentence(Finding("_amount")) == sentence(Finding("storm")) == ""


def test_a_stall_error_names_the_refused_messages() -> None:
    refused = {"kind": "rejected", "value": 7, "text": "7 messages on 1 key (first: agent/x/mission: queued: …)"}
    stall = StallError("stall: evaluator has handled 4 of 5 messages")
    assert str(ending.of_stall(stall, [refused])) == f"{stall}; refused: {refused['text']}"
    assert str(ending.of_stall(stall, [refused | {"kind": "foreign"}])) == str(stall)


# -- confidence ------------------------------------------------------------------------------------------------------

SURE, FINE = "overconfident", None


def compared(position: str | None, velocity: str | None, nees: float = 19.2) -> dict[str, Any]:
    """An estimate with these verdicts."""
    numbers = {"nees": nees, "factor": math.sqrt(nees / 2), "pairs": 100}
    return {"position": numbers | {"verdict": position}, "velocity": numbers | {"verdict": velocity}}


def confidence(consistency: object, **trackers: Innovations) -> list[Finding]:
    summaries = {name: each.summary() for name, each in trackers.items()}
    return [*notices.of_confidence({"consistency": consistency}, summaries)]


def found_of_confidence() -> Iterator[Finding]:
    """What is said of estimates and trackers."""
    for position, velocity, nees in ((SURE, FINE, 19.2), (FINE, SURE, 19.2), (SURE, SURE, 2e6)):
        yield from confidence({"infra_2": {"local": compared(position, velocity, nees)}})
    sure, fine = compared(SURE, FINE), compared(FINE, FINE)
    yield from confidence({"ego": {"received": sure, "picture": sure, "mission": sure}, "infra_1": {"local": sure}})
    yield from confidence({f"infra_{i}": {"local": sure} for i in range(50)})[-2:]
    sharp, nothing = Innovations(700.0, 100, 50), compared(FINE, FINE)
    for summary in nothing.values():
        summary["pairs"] = 0
    accurate = {"local": fine, "picture": compared("overcautious", "overcautious")}
    assert confidence({"ego": accurate}, ego=sharp) == [], "trackers are judged only where nothing was compared"
    yield from confidence({"ego": {"local": nothing}}, ego=sharp, infra_1=Innovations(200.0, 100, 0))
    yield from confidence({}, infra_1=Innovations(silent=9), infra_2=Innovations(silent=40))


@pytest.mark.parametrize(
    "returned",
    [None, 7, "text", [], {"ego": None}, {"ego": {"local": 3}}, {"ego": {"local": {"position": {"verdict": SURE}}}}],
)
def test_what_a_users_evaluator_returns_instead_has_no_line(returned: object) -> None:
    assert confidence(returned) == []


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
