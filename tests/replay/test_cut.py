"""Which nodes of a run are played, which are live, and which wires a replay has."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from mast_zenoh.config.resolved import Resolved
from mast_zenoh.replay.cut import Cut, Place, cut
from mast_zenoh.wiring.model import Wiring


@pytest.fixture
def divided(recorded: Callable[[str], Path]) -> Callable[[str, Place], Cut]:
    def of(name: str, place: Place) -> Cut:
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
    divided: Callable[[str, Place], Cut], name: str, place: Place, played: set[str], live: set[str]
) -> None:
    division = divided(name, place)
    assert division.played == played | {"simulator"}
    assert division.live == live


def test_all_players_and_live_nodes_receive_the_clock_once(divided: Callable[[str, Place], Cut]) -> None:
    division = divided("lossy", "agents")
    flows = [node for key, _, node in division.wiring.flows() if key == "clock"]
    assert sorted(flows) == sorted({*division.played, *division.live} - {"simulator"})


def test_what_depends_on_the_picture_is_left_out(divided: Callable[[str, Place], Cut]) -> None:
    wires = {wire.key: wire for wire in divided("lossy", "agents").wiring.wires}
    assert "agent/ego/mission" not in wires
    assert wires["cc/picture"].every_leg == wires["cc/picture"].legs
    assert not wires["cc/picture"].subscribers
    assert wires["agent/ego/tracks"].interposers == ("link_ego",)


def test_players_receive_nothing_but_the_clock_and_the_ways_to_branches(
    divided: Callable[[str, Place], Cut],
) -> None:
    division = divided("lossy", "agents")
    for name in division.played:
        ports = {(each.port, each.message) for each in division.wiring.ports(name).inputs.values()}
        assert ports <= {("clock", "clock"), ("unused", "tracks"), ("unused", "status")}, name
    assert not division.wiring.ports("ego").inputs.keys() - {"clock"}
