"""The messages of an invented agent are those of a real one."""

from __future__ import annotations

import numpy as np
import pytest

from mast_zenoh import scenario
from mast_zenoh.messages import codec
from mast_zenoh.messages.timespan import Timespan
from mast_zenoh.study.rogue import comparison
from mast_zenoh.study.rogue.sybil import Sybil


def test_the_tracks_of_an_invented_agent_pass_every_check_of_their_receivers() -> None:
    sybil = Sybil("a", "infra_3", objects=4)
    for number, frame in enumerate((7, 8, 9)):
        message = codec.decode(codec.encode(sybil.message(frame, 100_000_000, number)), "tracks")
        assert message.header == ("tracks", "infra_3", frame, frame * 100_000_000, number)
        assert Timespan(20, 100_000_000, 0).refusal(message.header, frame) == ""
        assert len(message.body["id"]) == 4
        assert np.abs(message.body["position"][:, :2]).max() <= 30.0


def test_two_invented_agents_claim_different_places() -> None:
    places = [Sybil("a", name).message(0, 1, 0).body["position"] for name in ("infra_3", "infra_4", "infra_3")]
    assert not np.array_equal(places[0], places[1])
    assert np.array_equal(places[0], places[2])


@pytest.mark.parametrize("wrong", [dict(objects=-1), dict(messages=0)])
def test_impossible_numbers_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="objects, messages"):
        Sybil("a", "infra_3", **wrong)


def test_the_agents_that_the_outsider_plays_are_absent_at_first() -> None:
    path, loaded = scenario.load("sybil")
    resolved = scenario.resolve(path, loaded)
    absent = {step.node for step in resolved.steps if step.action == "start" and step.frame > 60}
    identities = {attempt.identity for attempt in comparison.load("sybil") if isinstance(attempt, Sybil)}
    assert identities - {"ghost"} == absent
