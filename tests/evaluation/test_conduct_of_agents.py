"""On which wires a changed message makes its agent a liar."""

from __future__ import annotations

import pytest

from mast_zenoh.config import bundle
from mast_zenoh.evaluation.trust import UPSTREAM
from mast_zenoh.wiring import maps

WIRES = {
    wire["key"]: wire["from"].partition(".")
    for path in (bundle.ROOT / "keyexpr_maps").glob("*.toml")
    for wire in maps.load(path).get("wire", ())
    if wire["key"].startswith("agent/{agent}/")
}


@pytest.mark.parametrize("key", [key for key, (role, _, _) in WIRES.items() if role in ("agent", "peer")])
def test_all_that_an_agent_or_its_peer_says_of_the_world_counts(key: str) -> None:
    """Gossip is about other agents; estimates for itself, and judgements, are claims to nobody."""
    port = WIRES[key][2]
    assert (port in UPSTREAM) == (port not in ("gossip", "mission", "picture", "trust"))
