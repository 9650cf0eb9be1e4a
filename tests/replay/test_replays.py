"""Replays of recorded runs: which nodes are played, and what the live ones receive."""

import json
from collections import defaultdict
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from driven import driven
from recorded_runs import FRAMES, RUNS
from tiny_world import Run as Played

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import NotComparable
from mast_zenoh.launch import measurement, replay, twin
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.replay.cut import Place, ReplayedMesh, cut
from mast_zenoh.run_folder.recording.difference import compare
from mast_zenoh.run_folder.recording.reader import read
from mast_zenoh.runs.run import Run
from mast_zenoh.show import html
from mast_zenoh.show.comparison import reference
from mast_zenoh.show.findings import outcome
from mast_zenoh.wiring.model import Wiring


@pytest.fixture
def divided(recorded: Callable[[str], Path]) -> Callable[[str, Place], ReplayedMesh]:
    def of(name: str, place: Place) -> ReplayedMesh:
        resolved = Resolved.read(recorded(name))
        return cut(Wiring.from_json(resolved.wiring), {n: spec.role for n, spec in resolved.nodes.items()}, place)

    return of


CENTRE = {"broker", "command_center", "evaluator", "recorder"}
AGENTS = {"ego", "infra_1", "infra_2"}
ADVERSARIES = {"adversary_1", "adversary_2", "coordinator"}
LINKS = {"link_ego", "link_infra_1", "link_infra_2"}


@pytest.mark.parametrize(
    ("name", "place", "played", "live"),
    [
        ("baseline", "agents", AGENTS, CENTRE),
        ("baseline", "simulator", set(), CENTRE | AGENTS),
        ("uncoordinated", "agents", AGENTS | {"adversary_1"}, CENTRE),
        ("uncoordinated", "simulator", {"adversary_1"}, CENTRE | AGENTS),  # on detections: before the agents
        ("coordinated", "agents", AGENTS | ADVERSARIES, CENTRE),
        ("coordinated", "simulator", set(), CENTRE | AGENTS | ADVERSARIES),  # on tracks: after them
        ("lossy", "agents", AGENTS | ADVERSARIES | LINKS, CENTRE),
        ("lossy", "simulator", set(), CENTRE | AGENTS | ADVERSARIES | LINKS),
        ("downlink", "agents", AGENTS, CENTRE),  # its adversary is on the picture alone
    ],
)
def test_nodes_are_divided_at_the_cut(
    divided: Callable[[str, Place], ReplayedMesh], name: str, place: Place, played: set[str], live: set[str]
) -> None:
    division = divided(name, place)
    assert division.played == played | {"simulator"}
    assert division.live == live


@pytest.mark.parametrize(("place", "agents"), [("agents", {"ego", "infra_1"}), ("simulator", set())])
def test_drivers_and_what_is_on_their_commands_are_played_as_the_truth_follows_from_them(
    place: Place, agents: set[str]
) -> None:
    resolved = driven("attack=SeizedCommands", frames=4, record=True)
    roles = {name: spec.role for name, spec in resolved.nodes.items()}
    division = cut(Wiring.from_json(resolved.wiring), roles, place)
    assert division.played == {"simulator", "driver_ego", "adversary_1", *agents}


def test_what_depends_on_the_picture_is_left_out(divided: Callable[[str, Place], ReplayedMesh]) -> None:
    wires = {wire.key: wire for wire in divided("lossy", "agents").wiring.wires}
    assert "agent/ego/mission" not in wires
    assert wires["cc/picture"].every_leg == wires["cc/picture"].legs
    assert not wires["cc/picture"].subscribers
    assert wires["agent/ego/tracks"].interposers == ("link_ego",)


def test_players_receive_nothing_but_the_clock_and_the_ways_to_branches(
    divided: Callable[[str, Place], ReplayedMesh],
) -> None:
    division = divided("lossy", "agents")
    for name in division.played:
        ports = {(each.port, each.message) for each in division.wiring.ports(name).inputs.values()}
        assert ports <= {("clock", "clock"), ("unused", "tracks"), ("unused", "status")}, name
    assert not division.wiring.ports("ego").inputs.keys() - {"clock"}


PICTURE = ("cc/picture",)
CLUSTERING = "command_center.pipeline.clustering.assign_radius"

WITNESSES = '''
import numpy as np

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.node import Node
from mast_zenoh.fusion.pipelines import Pipeline


class Witnesses(Node):
    """Publishes objects with enough support."""

    role = "command_center"
    inputs = {"clock": "clock", "collated": "collated", "advice": "status"}
    outputs = {"picture": "picture"}

    def __init__(self, pipeline: Pipeline, least: int = 2):
        self.pipeline, self.least = pipeline, least

    def on_clock(self, received, context):
        pass

    def on_advice(self, received, context):
        raise AssertionError("no wire leads here")

    def on_collated(self, received, context):
        body = received.body
        states = ObjectStates.from_columns(body)
        picture, support = self.pipeline.step(received.time_ns, states, body["agent"], tuple(body["agents"]))
        kept = np.flatnonzero(support >= self.least)
        columns = picture.select(kept).columns() | {"support": support[kept]}
        context.publish("picture", columns, frame=received.frame, time_ns=received.time_ns)
'''


def replayed(folder: Path, out: Path, place: Any = "agents", **options: Any) -> launcher.EndedRun:
    """A replay in one process, which must succeed."""
    prepared = replay.resolve(folder, place, **options)
    ended = launcher.run(prepared.resolved, out, runtime="inproc", replay=prepared.record())
    assert ended.error is None
    return ended


def metrics(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "metrics.json").read_text())
    return content


@pytest.mark.parametrize("place", ["agents", "simulator"])
@pytest.mark.parametrize("name", sorted(RUNS.keys() - {"baseline", "coordinated"}))  # these are also played with links
def test_unchanged_nodes_compute_the_recorded_picture(
    recorded: Callable[[str], Path], tmp_path: Path, name: str, place: str
) -> None:
    run = replayed(recorded(name), tmp_path / "replay", place)
    pictures = compare(recorded(name), run.folder, wires=PICTURE)
    assert pictures.first is None
    assert pictures.equal >= FRAMES - 4, "the command centre may be down for some frames"
    everything = compare(recorded(name), run.folder, taps=True, ignore=("link/*/report",))
    assert not everything.differing
    assert not everything.only_b
    left_out = {
        "attack/adversary_1/report",
        "cc/picture",
        *(f"agent/{name}/mission" for name in ("ego", "infra_1", "infra_2")),
    }
    assert everything.only_a.keys() <= (left_out if place == "agents" else set())
    assert not run.record["nodes"]["broker"]["rejected"]
    assert not (run.folder / "played").exists()
    if (name, place) == ("uncoordinated", "agents"):
        *_, last = outcome(loaded := Run(run.folder), reference(loaded, recorded(name)))
        assert (last.kind, last.what, last.than) == ("unchanged", "shared scores", "uncoordinated")


def test_no_order_of_delivery_changes_the_picture(recorded: Callable[[str], Path]) -> None:
    resolved = replay.resolve(recorded("lossy"), record=False).resolved
    streams = [Played(resolved, shuffle=seed).messages["cc/picture"] for seed in (None, 1, 2)]
    assert streams[0] == streams[1] == streams[2]
    assert streams[0] == [m.payload for m in read(recorded("lossy")) if m.key == "cc/picture"]


def test_a_changed_setting_changes_the_picture_and_is_named_in_all_results(
    recorded: Callable[[str], Path], tmp_path: Path
) -> None:
    folder = recorded("uncoordinated")
    run = replayed(folder, tmp_path / "replay", settings=[f"{CLUSTERING}=0.05"])
    assert compare(folder, run.folder, wires=PICTURE).first is not None
    assert compare(folder, run.folder, wires=("agent/*", "scene/*", "clock")).equal > 0
    origin = json.loads((folder / "run.json").read_text())["id"]
    changed = {"command_center": ["pipeline.clustering.assign_radius"]}
    for content in (metrics(run.folder), json.loads((run.folder / "run.json").read_text())):
        assert (content["replay"]["run"], content["replay"]["changed"]) == (origin, changed)
    assert "recorded" not in json.dumps(run.record["notices"])
    page = html.write_report(run.folder, against=folder).read_text()
    assert "changed: command_center (pipeline.clustering.assign_radius)" in page
    assert "differ in command_center.pipeline.clustering.assign_radius" in page


def test_attacks_are_measured_in_a_replay_though_no_adversary_attacks(
    recorded: Callable[[str], Path], tmp_path: Path
) -> None:
    folder = recorded("lossy")
    run = replayed(folder, tmp_path / "replay")
    before, after = metrics(folder), metrics(run.folder)
    assert before["frames"] == after["frames"] == FRAMES
    for estimate in ("local", "received", "picture"):
        assert before["agents"]["ego"][estimate] == after["agents"]["ego"][estimate]
    assert "mission" not in after["agents"]["ego"]
    for name in ("adversary_1", "adversary_2", "link_ego"):
        assert after["interposers"][name]["agreement"] == before["interposers"][name]["agreement"], name
    effects = [each["interposers"]["adversary_1"]["effects"] for each in (before, after)]
    assert effects[0] == effects[1]
    assert any(effects[0].values())


def test_a_users_own_command_centre_takes_the_place_of_the_recorded_one(
    recorded: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "witnesses.py").write_text(WITNESSES)
    (tmp_path / "mine.py").write_text(
        "from mast_zenoh.config import loading\n"
        "_, baseline = loading.function('scenarios', 'baseline', 'scenario')\n"
        "def scenario(least=2):\n"
        "    usual = baseline()\n"
        "    center = usual['command_center'] | dict(file='witnesses.py', type='Witnesses', least=least)\n"
        "    return usual | dict(command_center=center)\n"
    )
    folder = recorded("coordinated")
    by_setting = replay.resolve(
        folder, settings=["command_center.file=witnesses.py", "command_center.least=3"], record=False
    )
    assert by_setting.origin["changed"] == {"command_center": ["file", "type", "least"]}
    (notice,) = by_setting.notices
    assert "command_center.advice" in notice
    by_file = replay.resolve(folder, scenario="mine.py", settings=["least=3"], record=False)
    pictures = [Played(each.resolved).messages["cc/picture"] for each in (by_setting, by_file)]
    assert pictures[0] == pictures[1]
    assert len(pictures[0]) == FRAMES
    assert pictures[0] != [m.payload for m in read(folder) if m.key == "cc/picture"]


def test_live_agents_take_their_settings_from_patterns_and_scenario_files(recorded: Callable[[str], Path]) -> None:
    folder = recorded("baseline")
    prepared = replay.resolve(folder, "simulator", settings=["agents.infra_*.status_every=2"], record=False)
    assert prepared.origin["changed"] == {"infra_1": ["status_every"], "infra_2": ["status_every"]}
    assert len(Played(prepared.resolved).messages["agent/infra_1/status"]) == FRAMES // 2
    unchanged = replay.resolve(folder, "simulator", scenario="baseline")
    assert unchanged.origin["changed"] == {}


def test_a_replay_can_be_replayed_and_measured_again(recorded: Callable[[str], Path], tmp_path: Path) -> None:
    first = replayed(recorded("lossy"), tmp_path / "first")
    second = replayed(first.folder, tmp_path / "second")
    assert compare(first.folder, second.folder, taps=True).first is None
    assert second.record["name"] == "coordinated-replay"
    before = metrics(second.folder)
    measurement.measure(second.folder)
    assert metrics(second.folder) == before
    assert before["replay"]["run"] == first.record["id"]


def test_repetitions_continue_frames_times_and_numbers(recorded: Callable[[str], Path], tmp_path: Path) -> None:
    folder = recorded("lossy")
    run = replayed(folder, tmp_path / "replay", repeats=3)
    assert metrics(run.folder)["frames"] == 3 * FRAMES
    first = compare(folder, run.folder, wires=PICTURE, before=FRAMES - 2)
    assert first.first is None
    numbers: defaultdict[str, list[int]] = defaultdict(list)
    for message in read(run.folder):
        assert message.time_ns == message.frame * 10**8
        numbers[message.key].append(message.seq)
    assert numbers["clock"] == numbers["scene/truth"] == list(range(3 * FRAMES))
    for key in ("agent/ego/tracks", "attack/adversary_1/report", "link/link_ego/report"):
        assert all(a < b for a, b in pairwise(numbers[key])), key
    assert not any(node["rejected"] for node in run.record["nodes"].values())
    adversary = metrics(run.folder)["interposers"]["adversary_1"]
    assert adversary["agreement"] == "agrees", "reports are about the repeated frames"


@pytest.mark.parametrize("frames", [None, 3])
def test_sensors_measure_at_their_times_in_every_repetition(
    recorded: Callable[[str], Path], tmp_path: Path, frames: int | None
) -> None:
    run = replayed(recorded("rates"), tmp_path / "replay", place="simulator", frames=frames, repeats=2)
    assert not any(node["rejected"] for node in run.record["nodes"].values())
    assert compare(recorded("rates"), run.folder, wires=PICTURE, before=frames or FRAMES).first is None


def test_a_replay_without_a_recorder_has_results_and_no_replay_has_a_twin(
    recorded: Callable[[str], Path], tmp_path: Path
) -> None:
    run = replayed(recorded("baseline"), tmp_path / "replay", record=False, frames=5)
    assert not (run.folder / "messages.mcap").exists()
    assert metrics(run.folder)["frames"] == 5
    with pytest.raises(NotComparable, match="is a replay"):
        twin.of(run.folder)
