"""Links and faults of messages between peers, and with several centres."""

from functools import cache
from typing import Any

import pytest
from tiny_world import Run, tiny

from mast_zenoh import scenario
from mast_zenoh.wiring.model import Wiring, to_text

ALONE = ("n_mobile=0",)
PEERS = ("peers", *ALONE)
ALL_WIRES = (*PEERS, "relays=true", "gossip=true")
CONGESTED = ("congested", *ALONE, "awareness=true", "defence=FaultOrLie")
CENTRES = ("two_centres",)
ON_BOARD = ("two_centres", "on_board=true")
WORLDS = (ALL_WIRES, CONGESTED, ON_BOARD)

PARTITION = dict(type="Partition", at=0.35, until=0.75, node="infra_1")
IMPERFECT = (
    PARTITION,
    dict(type="Loss", at=0.2, node="ego", probability=0.4),
    dict(type="Delay", at=0.1, until=0.9, node="infra_2", mean_s=0.15, jitter_s=0.1),
)
PROFILE = {"infra_*": "wireless_v2x"}
FRAMES_CUT = range(4, 8)


def world(settings: tuple[str, ...], faults: tuple[dict[str, Any], ...] = (), **more: Any) -> Any:
    def edit(content: dict[str, Any]) -> None:
        content.update(faults=list(faults), **more)

    name, *parameters = settings
    return tiny(name, *parameters, infrastructure=2, edit=edit)


@cache
def played(settings: tuple[str, ...], *faults: str) -> Run:
    run = Run(world(settings, (PARTITION,) if faults else ()))
    assert not run.failures
    assert not run.rejected
    return run


@cache
def imperfect(settings: tuple[str, ...]) -> Run:
    run = Run(world(settings, IMPERFECT, links=PROFILE))
    assert not run.failures
    return run


@pytest.mark.parametrize("settings", WORLDS, ids=" ".join)
def test_a_link_without_rules_changes_no_message(settings: tuple[str, ...]) -> None:
    plain, linked = played(settings), Run(world(settings, links={"*": "perfect"}))
    assert not linked.failures
    for key, messages in plain.messages.items():
        assert linked.messages[key] == messages, key


@pytest.mark.parametrize("settings", WORLDS, ids=" ".join)
def test_the_evaluator_measures_what_links_report(settings: tuple[str, ...]) -> None:
    interposers = imperfect(settings).results["evaluator"]["metrics"]["interposers"]
    agreement = {name: part["agreement"] for name, part in interposers.items()}
    assert agreement == dict.fromkeys(("link_ego", "link_infra_1", "link_infra_2"), "agrees")
    assert interposers["link_infra_1"]["effects"]["dropped"] > 0
    assert interposers["link_infra_2"]["effects"]["delayed"] > 0


def test_corrupted_messages_between_peers_cost_one_message_each_and_are_measured() -> None:
    corrupt = dict(type="Corrupt", at=0.1, node="ego", probability=0.7, flips=3)
    run = Run(world(ALL_WIRES, (corrupt,)))
    assert not run.failures
    assert run.rejected.keys() <= {"peer_ego", "peer_infra_1", "peer_infra_2"}
    effects = run.results["evaluator"]["metrics"]["interposers"]["link_ego"]["effects"]
    assert effects["corrupted"] > 0


def test_what_a_peer_refuses_of_a_flood_does_not_depend_on_the_order_of_delivery() -> None:
    flood = dict(type="Flood", at=0.2, until=0.7, node="infra_2", copies=20)
    held = dict(type="Pause", at=0.3, until=0.6, node="infra_2")
    resolved = world((*PEERS, "relays=true"), (flood, held))
    plain, other = Run(resolved), Run(resolved, shuffle=1)
    overflown = {(node, key.split("/")[2]) for node, keys in plain.rejected.items() for key, _ in keys}
    assert {("peer_ego", "broadcast"), ("peer_ego", "relay")} <= overflown
    assert other.messages == plain.messages
    assert other.rejected == plain.rejected


def heard(run: Run, agent: str) -> dict[str, int]:
    counts = run.results[f"peer_{agent}"]["radio"]
    return {name.removeprefix("heard/"): n for name, n in counts.items() if name.startswith("heard/")}


def test_a_partitioned_peer_neither_hears_nor_is_heard_and_the_others_hear_each_other() -> None:
    whole, cut = played(ALL_WIRES), played(ALL_WIRES, "partition")
    n = len(FRAMES_CUT)
    assert heard(whole, "ego") == {"infra_1": 11, "infra_2": 11}
    assert heard(cut, "ego") == {"infra_1": 11 - n, "infra_2": 11}
    assert heard(cut, "infra_2") == {"ego": 11, "infra_1": 11 - n}
    assert heard(cut, "infra_1") == {"ego": 11 - n, "infra_2": 11 - n}
    for wire in ("broadcast", "broadcast_view", "relay", "gossip"):
        sent = [message.header.frame for message in cut.decoded(f"agent/infra_1/{wire}", schema(cut, wire))]
        assert sent == [frame for frame in range(12) if frame not in FRAMES_CUT], wire
        into = [f"agent/{other}/{wire}/@tap/peer_infra_1/0" for other in ("ego", "infra_2")]
        for key in into:
            frames = [message.header.frame for message in cut.decoded(key, schema(cut, wire))]
            assert frames == [frame for frame in range(12) if frame not in FRAMES_CUT], key


def schema(run: Run, wire: str) -> str:
    return {"broadcast": "tracks", "broadcast_view": "view", "relay": "relayed", "gossip": "gossip"}[wire]


def test_a_fault_of_one_direction_leaves_the_other() -> None:
    up, down = (Run(world(PEERS, (PARTITION | dict(direction=direction),))) for direction in ("up", "down"))
    n = len(FRAMES_CUT)
    assert heard(up, "infra_1") == {"ego": 11, "infra_2": 11}
    assert heard(up, "ego") == {"infra_1": 11 - n, "infra_2": 11}
    assert heard(down, "infra_1") == {"ego": 11 - n, "infra_2": 11 - n}
    assert heard(down, "ego") == {"infra_1": 11, "infra_2": 11}


def test_what_a_link_drops_before_the_channel_takes_no_time_on_the_air() -> None:
    plain = Run(world(("congested", *ALONE, "rules=EveryFrame")))
    cut = Run(world(("congested", *ALONE, "rules=EveryFrame"), (PARTITION,)))
    assert cut.results["channel"]["channel"]["frames"] == plain.results["channel"]["channel"]["frames"] - len(
        FRAMES_CUT
    )


@pytest.mark.parametrize("settings", [CENTRES, ON_BOARD], ids=" ".join)
def test_a_partitioned_agent_reaches_no_centre_and_the_others_all(settings: tuple[str, ...]) -> None:
    whole, cut = played(settings), played(settings, "partition")
    sent = [message.header.frame for message in cut.decoded("agent/infra_1/tracks", "tracks")]
    assert sent == [frame for frame in range(12) if frame not in FRAMES_CUT]
    for agent in ("ego", "infra_2"):
        assert cut.messages[f"agent/{agent}/tracks"] == whole.messages[f"agent/{agent}/tracks"]


@pytest.mark.parametrize(("settings", "key"), [(CENTRES, "cc/picture"), (ON_BOARD, "cc/on_board/picture")])
def test_a_partitioned_ego_gets_no_picture(settings: tuple[str, ...], key: str) -> None:
    run = Run(world(settings, (PARTITION | dict(node=key),)))
    received = {message.header.frame for message in run.decoded(f"{key}/@tap/ego/0", "picture")}
    published = {message.header.frame for message in run.decoded(key, "picture")}
    assert published - received == set(FRAMES_CUT)
    assert len(run.messages["agent/ego/tracks"]) == 12


def test_an_adversary_on_what_one_peer_hears_comes_before_that_peers_link() -> None:
    liar = ("peers", *ALONE, "n_adversaries=1", "on=pair")
    text = to_text(Wiring.from_json(world(liar, links={"*": "perfect"}).wiring))
    assert "peer_infra_1 ─▶ [link_infra_1] ─▶ ([adversary_1] ─▶ [link_ego] ─▶ peer_ego)" in text


@pytest.mark.heavy
def test_what_peers_miss_because_of_a_partition_is_put_down_to_the_fault() -> None:
    missed = {}
    for faults in ([], [dict(type="Partition", at=2.0, until=4.0, node="infra_1")]):
        path, content = scenario.load("peers", ["scene=intersection:8"])
        run = Run(scenario.resolve(path, content | dict(faults=faults), frames=60, seed=0))
        agents = run.results["evaluator"]["metrics"]["agents"]
        missed[bool(faults)] = {agent: agents[agent]["picture"]["fn_split"] for agent in agents}
        assert not any(agents[agent]["local"]["fn_split"]["fault"] for agent in agents)
    for agent, split in missed[True].items():
        assert split["natural"] == pytest.approx(missed[False][agent]["natural"], abs=0.2), agent
        assert split["attack"] == 0.0
    faulty = {agent: split["fault"] for agent, split in missed[True].items()}
    assert faulty["infra_1"] > 2.5 * max(faulty[agent] for agent in faulty if agent != "infra_1")
    assert min(faulty.values()) > 0.0, "infra_1 alone sees some objects"
