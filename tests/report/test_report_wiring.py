"""The wiring diagram and table: interposers by wire."""

import itertools
from typing import Any

import pytest

from mast_zenoh.runs.files import RunFiles
from mast_zenoh.runs.run import Run
from mast_zenoh.show.figures.diagram import draw_wiring
from mast_zenoh.show.figures.style import svg
from mast_zenoh.show.tables.wiring import HIGH, ROW, WIDE, Spot, layout, wire_rows


def a_run(wires: list[dict[str, Any]], roles: dict[str, str] | None = None) -> Run:
    nodes = {name: {"role": role} for name, role in (roles or {}).items()}
    return Run.of(RunFiles(None, record={"nodes": nodes}, wiring={"wires": wires}))


def a_wire(
    key: str, message: str, publisher: str, subscribers: list[str], chain: tuple[str, ...] = ()
) -> dict[str, Any]:
    targets = [*([stop] for stop in chain), subscribers]
    keys = [*(f"{key}/@tap/{i}" for i in range(len(chain))), key]
    legs = [{"key": k, "from": stop, "to": to} for k, stop, to in zip(keys, [publisher, *chain], targets, strict=True)]
    record = {"key": key, "message": message, "publisher": publisher, "subscribers": subscribers}
    return record | {"legs": legs, "interposers": list(chain)}


def mesh(agents: int, chain: int, message: str) -> Run:
    """A run with `chain` links on each agent's wires of the type `message`, or "both"."""
    wires, roles = [], {"simulator": "simulator", "broker": "broker", "command_center": "command_center"}
    for name in ["ego", *(f"infra_{k}" for k in range(1, agents))]:
        links = tuple(f"{name}_link_{k}" for k in range(chain))
        roles |= {name: "agent"} | dict.fromkeys(links, "link")
        for kind, ends in (("detections", ("simulator", [name])), ("tracks", (name, ["broker"]))):
            wires.append(a_wire(f"agent/{name}/{kind}", kind, *ends, links if message in (kind, "both") else ()))
    wires.append(a_wire("cc/collated", "collated", "broker", ["command_center"]))
    wires.append(a_wire("cc/picture", "picture", "command_center", [n for n, r in roles.items() if r == "agent"]))
    return a_run(wires, roles)


@pytest.mark.parametrize("message", ["detections", "tracks", "both"])
@pytest.mark.parametrize(("agents", "chain"), [(1, 0), (5, 1), (12, 3)])
def test_nodes_do_not_overlap(agents: int, chain: int, message: str) -> None:
    plan = layout(mesh(agents, chain, message))
    assert len(plan.places) == 3 + agents * (1 + (2 if message == "both" else 1) * chain)
    for (ax, ay), (bx, by) in itertools.combinations(plan.places.values(), 2):
        assert abs(ax - bx) >= WIDE or abs(ay - by) >= HIGH


@pytest.mark.parametrize("agents", [2, 7, 20])
def test_peers_stand_beside_their_agents_and_send_to_one_node_for_all_others(agents: int) -> None:
    names = [f"car_{k}" for k in range(agents)]
    roles = {"simulator": "simulator", "liar": "adversary"} | dict.fromkeys(names, "agent")
    wires = []
    for name in names:
        roles[f"peer_{name}"] = "peer"
        wires.append(a_wire(f"agent/{name}/detections", "detections", "simulator", [name]))
        wires.append(a_wire(f"agent/{name}/tracks", "tracks", name, [f"peer_{name}"]))
        wires.append(a_wire(f"agent/{name}/picture", "picture", f"peer_{name}", [name]))
        others = [f"peer_{other}" for other in names if other != name]
        liars = ("liar",) if name == "car_1" else ()
        wires.append(a_wire(f"agent/{name}/broadcast", "tracks", f"peer_{name}", others, liars))
    for wire in wires:
        wire["subject"] = wire["key"].split("/")[1]
    plan = layout(a_run(wires, roles))
    for (ax, ay), (bx, by) in itertools.combinations(plan.places.values(), 2):
        assert abs(ax - bx) >= WIDE or abs(ay - by) >= HIGH
    for name in names:
        (x, y), (beside, level) = plan.places[Spot(name)], plan.places[Spot(f"peer_{name}")]
        assert (beside > x, level) == (True, y)
    hearing = Spot("all other peers") if agents > 2 else Spot("peer_car_0")
    assert "liar" in {source.node for source, target in plan.lines if target == hearing}
    assert len([pair for pair in plan.lines if "peer" in pair[0].node]) == 2 * agents


def test_nodes_on_a_wire_are_between_its_ends_in_order() -> None:
    plan = layout(mesh(3, 2, "tracks"))
    infra, links = Spot("infra_1"), [Spot(f"infra_1_link_{k}", after=1) for k in (0, 1)]
    xs = [plan.places[spot][0] for spot in (infra, *links, Spot("broker"))]
    assert xs == sorted(xs)
    assert plan.lines[infra, links[0]].linked
    assert (infra, Spot("broker")) not in plan.lines


def test_a_listener_is_drawn_on_its_leg_and_named_in_the_table() -> None:
    wire = a_wire("agent/ego/tracks", "tracks", "ego", ["broker"], ("mallory",))
    wire["listeners"] = [
        {"node": "guard", "port": "tracks", "source": False, "key": "agent/ego/tracks"},
        {"node": "source_guard", "port": "tracks", "source": True, "key": "agent/ego/tracks/@tap/0"},
    ]
    run = a_run([wire], {"ego": "agent", "broker": "broker", "mallory": "adversary"})
    plan = layout(run)
    mallory = Spot("mallory", after=1)
    assert {to for source, to in plan.lines if source == mallory} == {Spot("broker"), Spot("guard")}
    assert {to for source, to in plan.lines if source == Spot("ego")} == {mallory, Spot("source_guard")}
    assert draw_wiring(run) is not None
    assert wire_rows(run)[0].subscribers == ("broker", "guard (listens)", "source_guard (listens)")


def branched(trunk: tuple[str, ...] = ()) -> Run:
    """The picture's wire with a link per agent and interposers on the trunk."""
    agents = ["ego", "infra_1", "infra_2"]
    wire = a_wire("cc/picture", "picture", "command_center", [*agents, "evaluator"], trunk)
    wire["legs"][-1]["to"] = ["ego", "link_infra_1", "link_infra_2", "evaluator"]
    for agent in agents[1:]:
        key = f"cc/picture/@tap/{agent}/0"
        wire["legs"].append({"key": key, "from": f"link_{agent}", "to": [agent], "before": agent})
    wire["interposers"] += ["link_infra_1", "link_infra_2"]
    roles = dict.fromkeys(agents, "agent") | {"link_infra_1": "link", "link_infra_2": "link", "mallory": "adversary"}
    return a_run([wire], roles | {"command_center": "command_center", "evaluator": "evaluator"})


def test_a_link_before_one_subscriber_is_drawn_next_to_it_and_does_not_affect_the_others() -> None:
    plan = layout(branched())
    link, agent, centre = Spot("link_infra_2", after=1), Spot("infra_2"), Spot("command_center")
    assert plan.places[link][1] == pytest.approx(plan.places[agent][1] - 0.5 * ROW)
    assert plan.places[link][0] == plan.places[Spot("link_infra_1", after=1)][0]
    assert plan.lines[link, agent].linked
    assert plan.lines[centre, link].linked
    assert not plan.lines[centre, Spot("ego")].linked
    assert not any(line.intercepted for line in plan.lines.values())


def test_interposer_on_the_trunk_intercepts_all_branches() -> None:
    run = branched(("mallory",))
    plan = layout(run)
    mallory = Spot("mallory", after=1)
    assert plan.places[mallory][0] < plan.places[Spot("link_infra_1", after=1)][0]
    assert plan.lines[Spot("command_center"), mallory].intercepted
    assert plan.lines[mallory, Spot("ego")].intercepted
    (row,) = wire_rows(run)
    assert row.intercepted
    assert row.links == ("link_infra_1", "link_infra_2")
    assert row.branches == ("infra_1", "infra_2")
    assert wire_rows(branched())[0].intercepted is False


def test_unknown_roles_and_unusual_names_are_drawn() -> None:
    run = a_run([a_wire("x", "y$_{", "my$node^{", ["a name that is far too long for its box", "ego"])])
    figure = draw_wiring(run)
    assert b"<svg" in svg(figure)
