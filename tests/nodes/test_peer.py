"""What a peer does with what others relay."""

from typing import Any

import numpy as np
from tiny_world import Bench, tiny, tracks

from mast_zenoh.messages.schemas import text

AGENTS = ("ego", "infra_1", "infra_2")


def relayed(agents: list[str]) -> dict[str, Any]:
    """A picture with one object, which comes from some agents."""
    body = {name: column for name, column in tracks((5.0, 0.0)).items() if name not in ("origin", "rotation")}
    return body | {"agents": text(agents), "origin": np.ones((1, len(agents)), np.uint8)}


def origins_of_the_next_relay(agents: list[str]) -> tuple[list[str], dict[Any, int]]:
    """The agents in what the ego's peer relays, after infra_1 relayed an object; and what the peer rejected."""
    peer = Bench(tiny("peers", "relays=true"), "peer_ego")
    peer.clock(0)
    peer.send("relayed", relayed(agents), 0, subject="infra_1")
    published = peer.clock(1) + peer.send("own", tracks((30.0, 0.0)), 1) + peer.clock(2)
    published += peer.send("pose", {"position": np.zeros(3), "rotation": np.eye(4)[0], "velocity": np.zeros(3)}, 1)
    bodies = [message.body for _, message in [*published, *peer.clock(3)] if message.header.schema == "relayed"]
    return list(bodies[-1]["agents"]), dict(peer.host.rejected)


def test_what_another_relays_from_agents_of_the_run_is_fused_with_its_origins() -> None:
    agents, rejected = origins_of_the_next_relay(["infra_1", "infra_2"])
    assert set(agents) >= {"infra_1", "infra_2"}
    assert rejected == {}


def test_a_relayed_picture_that_names_other_agents_is_refused_and_its_names_go_no_further() -> None:
    agents, rejected = origins_of_the_next_relay(["infra_1", *(f"nobody_{k}" for k in range(500))])
    assert set(agents) <= set(AGENTS)
    assert sum(rejected.values()) == 1
