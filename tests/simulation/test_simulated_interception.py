"""Nodes are inserted into wires of simulated runs and released, with many interleavings; subscribers see nothing."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from simulated_runs import assert_same_messages, in_one_process, listening, on_simulated_mesh, resolve, schedule
from small_worlds import small_world

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.launch import live_interception
from mast_zenoh.mesh.control.interception import Intercept
from mast_zenoh.messages import codec
from mast_zenoh.testing.simulation import SimulatedWorld, check, play
from mast_zenoh.wiring.insertion import InsertionPoint

LIVE = Path(__file__).parents[1] / "support" / "live"
RELAY, ADVERSARY = str(LIVE / "relay.py"), "adversary.py"
TRACKS, DETECTIONS = "agent/infra_1/tracks", "agent/infra_1/detections"
TIMES = 20

SHOVER = """
import numpy as np

from mast_zenoh.node import Node


class Shover(Node):
    role = "adversary"
    inputs = {"clock": "clock", "tracks": "tracks"}
    outputs = {"tracks_out": "tracks"}

    def on_clock(self, received, context): ...

    def on_tracks(self, received, context):
        moved = received.body["position"] + np.array([0.0, 5.0, 0.0])
        context.relay("tracks_out", received, {**received.body, "position": moved})
"""


def tapped(mode: str, frames: int) -> SimulatedWorld:
    """The small world, in which relays can be inserted into what agent a sends and receives."""
    world = small_world(mode=mode, frames=frames)
    (relay,) = world.requests
    upstream = replace(relay.place, wire="number/a")
    build = world.build
    return replace(
        world,
        build=lambda name, spec: build("relay" if name == "relay_up" else name, spec),
        requests=(relay, relay._replace(name="relay_up", place=upstream)),
    )


def request(resolved: Resolved, wire: str, file: str, name: str, *settings: str, before: str = "") -> Intercept:
    """A request to insert a node, as `mast intercept` makes it."""
    return Intercept(*live_interception.plan(resolved, wire, file, name=name, settings=settings, before=before), ())


def test_twenty_insertions_and_removals_lose_duplicate_and_reorder_nothing() -> None:
    world = tapped("realtime", 290)
    turns = [(0.1 + 0.26 * i, ("relay", "relay_up")[i % 2]) for i in range(TIMES)]
    steps = [step for at_s, name in turns for step in ((at_s, "intercept", name), (at_s + 0.13, "release", name))]
    outcome = play(world, schedule(1, *steps, calm=True))
    assert (outcome.error, outcome.lost, outcome.refused, outcome.violations) == ("", {}, [], [])
    done = [(change["action"], change["node"]) for change in outcome.changes]
    assert done == [(action, name) for _, name in turns for action in ("intercept", "release")]
    assert outcome.on_the_way == 0
    for name in ("a", "b", "hub", "listener"):
        counts = outcome.results[name]
        assert (counts["twice"], counts["missing"], counts["disordered"]) == (0, 0, 0), name
        assert counts["handled"] > 540, name


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_insertions_and_removals_at_any_time_break_no_promise(mode: str) -> None:
    world = tapped(mode, 40)
    for seed in range(8):
        first, second = ("relay", "relay_up")[:: 1 if seed % 2 else -1]
        at_s = 0.03 + 0.014 * seed
        steps = [
            (at_s, "intercept", first),
            (at_s + 0.02, "intercept", second),
            (at_s + 0.15, "release", first),
            (at_s + 0.2, "release", second),
        ]
        assert check(world, schedule(seed, *steps)) == []


@pytest.mark.heavy
def test_in_lock_step_the_stream_equals_that_of_an_undisturbed_run() -> None:
    resolved = resolve("baseline", "n_infrastructure=1", frames=50)
    expected = in_one_process(resolved).messages
    requests = (
        request(resolved, TRACKS, ADVERSARY, "mallory", "attack.type=PassThrough"),
        request(resolved, TRACKS, RELAY, "eve"),
        request(resolved, DETECTIONS, RELAY, "relay", "keeps=False"),
    )
    for seed in range(3):
        steps = [
            *((0.1 + 0.02 * seed, "intercept", name) for name in ("mallory", "eve", "relay")),
            *((0.3 + 0.02 * seed, "release", name) for name in ("mallory", "eve")),
        ]
        played, outcome = on_simulated_mesh(resolved, schedule(seed, *steps), requests)
        assert outcome.claims_to_be_exact(), seed
        assert [change["action"] for change in outcome.changes] == ["intercept"] * 3 + ["release"] * 2, seed
        assert all(message.step == message.frame for message in played.messages), "an inserted node delays nothing"
        assert_same_messages(played.without_taps(), expected, str(seed))
        taps = {message.key for message in played.messages} - {message.key for message in expected}
        assert taps == {f"{TRACKS}/@tap/0", f"{TRACKS}/@tap/1", f"{DETECTIONS}/@tap/0"}
        at = {(change["action"], change["node"]): change["frame"] for change in outcome.changes}
        for key, name in ((f"{TRACKS}/@tap/0", "mallory"), (f"{TRACKS}/@tap/1", "eve")):
            assert played.frames(key) == list(range(at["intercept", name], at["release", name])), seed
        assert played.frames(f"{DETECTIONS}/@tap/0") == list(range(at["intercept", "relay"], 50)), seed


def test_an_attack_started_during_a_run_deceives_from_its_first_frame_on_and_is_reported() -> None:
    resolved = resolve("baseline", "n_infrastructure=1", frames=30)
    plain = in_one_process(resolved)
    settings = ("attack.type=UncoordinatedAttack", "attack.start_s=0")
    mallory = request(resolved, DETECTIONS, ADVERSARY, "mallory", *settings)
    for seed in range(2):
        played, outcome = on_simulated_mesh(resolved, schedule(seed, (0.1, "intercept", "mallory")), (mallory,))
        (change,) = outcome.changes
        reports = played.frames("attack/mallory/report")
        assert reports, seed
        assert set(reports) <= set(range(change["frame"], 30)), seed
        assert played.frames(DETECTIONS) == list(range(30)), seed
        of_victim = zip(
            *([m.payload for m in run.messages if m.key == DETECTIONS] for run in (played, plain)), strict=True
        )
        differing = [frame for frame, (found, honest) in enumerate(of_victim) if found != honest]
        assert min(differing) >= change["frame"], seed
        assert set(reports) >= set(differing), "each lie is reported"


def test_a_liar_inserted_on_one_pair_of_peers_changes_what_that_receiver_hears_and_nothing_else() -> None:
    """adversary_1 is on that pair since launch, but its attack starts after the end."""
    settings = ("n_infrastructure=2", "n_mobile=0", "n_adversaries=1", "on=pair", "attack_start_s=1000")
    resolved = resolve("peers", *settings, frames=40)
    plain = in_one_process(resolved)
    attack = ("attack.type=UncoordinatedAttack", "attack.start_s=0")
    mallory = request(resolved, "agent/infra_1/broadcast", ADVERSARY, "mallory", *attack, before="peer_ego")
    pair = "agent/infra_1/broadcast/@tap/peer_ego/0"
    steps = [(0.12, "intercept", "mallory"), (0.42, "release", "mallory")]
    played, outcome = on_simulated_mesh(resolved, schedule(1, *steps), (mallory,))
    assert outcome.claims_to_be_exact()
    first, last = (change["frame"] for change in outcome.changes)
    assert 10 < last < 38, "time remains before and after the attack"
    honest = {(sent.key, sent.frame, sent.seq): sent for sent in plain.messages}
    found = {(sent.key, sent.frame, sent.seq): sent for sent in played.messages}
    own = {"attack/mallory/report", "agent/infra_1/broadcast/@tap/peer_ego/1"}
    assert found.keys() - honest.keys() == {place for place in found if place[0] in own}
    assert honest.keys() <= found.keys(), "no message is lost"
    changed = [place for place, sent in honest.items() if found[place] != sent]
    assert {key for key, _, _ in changed} == {pair, "agent/ego/picture", "agent/ego/mission"}
    lies = {frame for key, frame, _ in changed if key == pair}
    assert lies
    assert first <= min(lies) <= max(lies) < last, "before and after it, the pair is as without it"
    for place in changed:
        if place[0] == pair:
            header = codec.decode_header(found[place].payload, "tracks")
            assert header == codec.decode_header(honest[place].payload, "tracks"), "nothing gives the liar away"


def test_in_real_time_a_node_on_one_pair_forwards_all_that_it_keeps_before_it_leaves() -> None:
    settings = ("n_infrastructure=1", "n_mobile=0", "n_adversaries=1", "on=pair", "attack_start_s=1000")
    resolved = resolve("peers", *settings, mode="realtime", frames=40)
    wire = "agent/infra_1/broadcast"
    relay = request(resolved, wire, RELAY, "relay", "keeps=True", before="peer_ego")
    steps = [(0.6, "intercept", "relay"), (2.0, "release", "relay")]
    played, outcome = on_simulated_mesh(resolved, schedule(1, *steps, calm=True), (relay,))
    assert [change["action"] for change in outcome.changes] == ["intercept", "release"]
    on_pair, tapped_ = (
        [sent.seq for sent in played.messages if sent.key == f"{wire}/@tap/peer_ego/{tap}"] for tap in (0, 1)
    )
    assert on_pair == list(range(len(on_pair))), "none is lost, doubled or out of order"
    assert len(on_pair) == len(played.frames(wire)) >= 39
    assert len(set(tapped_)) == len(tapped_) > 5, "they went through the node"


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_an_inserted_node_is_measured_from_then_on_and_credited_alone(mode: str, tmp_path: Path) -> None:
    """adversary_1 is on infra_1's detections, but its attack starts after the end."""
    (tmp_path / "shover.py").write_text(SHOVER)
    settings = ("n_infrastructure=1", "n_adversaries=1", "attack_start_s=1000")
    resolved = resolve("uncoordinated", *settings, mode=mode, frames=40)
    mallory = request(resolved, TRACKS, str(tmp_path / "shover.py"), "mallory")
    disturbed = schedule(1, (0.15 if mode == "lockstep" else 1.0, "intercept", "mallory"), calm=mode == "realtime")
    _, outcome = on_simulated_mesh(resolved, disturbed, (mallory,))
    (change,) = outcome.changes
    assert change["frame"] < 30, "time remains for the attack"
    attacks, objects = (outcome.results["evaluator"]["tables"][name] for name in ("attacks", "objects"))
    metrics = outcome.results["evaluator"]["metrics"]
    assert set(attacks["interposer"]) == {"mallory"}
    assert set(attacks["wire"]) == {TRACKS}
    moved = np.array(attacks["effect"]) == "moved"
    first = change["frame"] - (mode == "realtime")  # messages about a frame may be late and take the new path
    frames = np.asarray(attacks["frame"])[moved]
    assert frames.min() >= first
    assert frames.max() == 39, "until the end"
    offset = np.column_stack([np.subtract(attacks[f"after_{axis}"], attacks[f"before_{axis}"]) for axis in "xyz"])[
        moved
    ]
    np.testing.assert_allclose(offset, np.tile([0.0, 5.0, 0.0], (len(offset), 1)), atol=1e-9)
    verdicts = {name: verdict["agreement"] for name, verdict in metrics["interposers"].items()}
    assert verdicts == {"adversary_1": "nothing to report", "mallory": "silent"}
    by = np.array(objects["by"])
    assert set(by[by != ""]) == {"mallory"}
    assert np.asarray(objects["frame"])[by != ""].min() >= first
    assert metrics["agents"]["infra_1"]["received"]["fp_split"]["attack"] > 0.0
    assert metrics["agents"]["infra_1"]["local"]["fp_split"]["attack"] == 0.0


@pytest.mark.parametrize("mode", ["lockstep", "realtime"])
def test_a_wire_recovers_after_its_inserted_node_is_killed(mode: str) -> None:
    frames = 120
    world = listening(tapped(mode, frames))
    for seed in range(3):
        kill_s = 0.12 + 0.01 * seed
        steps = [(0.05, "intercept", "relay"), (kill_s, "kill", "relay")]
        outcome = play(world, schedule(seed, *steps, calm=True))
        assert (outcome.error, outcome.frames) == ("", frames), seed
        assert [change["action"] for change in outcome.changes] == ["intercept", "heal"], seed
        assert any("healed without relay" in note for note in outcome.notes), seed
        healed = outcome.changes[-1]["frame"]
        numbers = outcome.results["listener"]["heard"]["a"]
        assert all(before < after for before, after in pairwise(numbers)), "in order, without duplicates"
        after = [frame for _, frame in numbers if frame > healed]
        assert after == list(range(healed + 1, frames)), "nothing is lost any more"
        assert len(after) > 5, seed


def test_impossible_requests_are_refused_with_the_reason_and_change_nothing() -> None:
    world = small_world(frames=60)
    undisturbed = play(world, schedule(0))
    (relay,) = world.requests
    taken = relay._replace(name="b")
    nowhere = relay._replace(name="lost", place=InsertionPoint("agent/c/out", "into", "out", {"clock": "clock"}))
    world = replace(world, requests=(taken, nowhere))
    for seed in range(4):
        steps = [(0.05, "intercept", "b"), (0.06, "intercept", "lost"), (0.07, "release", "nobody")]
        outcome = play(world, schedule(seed, *steps))
        duplicate, unknown, absent = outcome.refused
        assert duplicate.startswith("ConfigurationError: node 'b'")
        assert unknown.startswith("WiringError: no wire")
        assert absent.startswith("WiringError: no node")
        assert outcome.changes == []
        assert outcome.claims_to_be_exact(), seed
        assert outcome.results == undisturbed.results, seed


def test_a_node_that_ends_before_it_is_on_its_wire_is_refused_and_changes_nothing() -> None:
    world = small_world(frames=80)
    undisturbed = play(world, schedule(0))
    refused = 0
    for number in range(0, 24, 3):
        outcome = play(world, schedule(number, (0.05, "intercept", "relay"), (0.06 + 0.0015 * number, "kill", "relay")))
        assert outcome.error == "", number
        if outcome.refused:
            refused += outcome.refused[0].startswith("StartError: relay ended before it could be put on agent/a/out: ")
            assert outcome.changes == [], number
            assert outcome.results == undisturbed.results, number
    assert refused > 1, outcome.refused
