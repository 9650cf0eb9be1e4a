"""On which wires a changed message makes its agent a liar."""

import pytest

from mast_zenoh.evaluation.estimate_wires import EstimateWires
from tests.support.wirings import wiring_of

MAPS = ("views.toml", "awareness.toml", "relays.toml", "gossip.toml")
BETWEEN_PEERS = wiring_of(["ego", "infra_1"], *MAPS, peers=True)


@pytest.mark.parametrize("wire", [wire.key for wire in BETWEEN_PEERS.wires if wire.subject == "ego"])
def test_all_that_an_agent_or_its_peer_says_of_the_world_counts(wire: str) -> None:
    """Gossip is about other agents; estimates for itself, and judgements, are claims to nobody."""
    speaker = EstimateWires(BETWEEN_PEERS, ["ego", "infra_1"]).speaker(wire)
    private = ("gossip", "mission", "picture", "trust", "status")  # a status goes to centres
    assert speaker == ("" if wire.rpartition("/")[2] in private else "ego")
