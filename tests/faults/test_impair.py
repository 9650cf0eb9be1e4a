"""`Impair` applies any rule of a link for a time, also one of a user's own file."""

from __future__ import annotations

from pathlib import Path

from tiny_world import Run, tiny

from mast_zenoh import scenario
from mast_zenoh.links import Rule

OWN_RULE = """
from mast_zenoh.links import Rule
from mast_zenoh.scenario import load


class EveryNth(Rule):
    fate = "dropped"

    def __init__(self, n, at=0.0, until=None):
        super().__init__(at, until)
        self.n, self.count = n, 0

    def apply(self, passage, row):
        self.count += 1
        return () if self.count % self.n == 0 else (passage,)


def scenario():
    _, base = load("baseline")
    fault = dict(type="Impair", rule=dict(type="EveryNth", n=3), on="infra_1", at=0.5, until=2.0)
    return base | dict(faults=[fault])
"""


class OnlyFirst(Rule):
    """Drops all messages but the first that it sees."""

    fate = "dropped"
    seen = False

    def apply(self, passage, row):
        first, self.seen = not self.seen, True
        return (passage,) if first else ()


def received(run: Run, key: str) -> list[int]:
    """The frames of the messages that the broker gets on the wire of an agent's tracks."""
    (tap,) = (other for other in run.messages if other.startswith(f"{key}/@tap/broker"))
    return [message.header.frame for message in run.decoded(tap, "tracks")]


def test_a_rule_of_ones_own_acts_while_the_fault_lasts() -> None:
    def edit(content: dict) -> None:
        content["faults"] = [dict(type="Impair", rule=dict(type=OnlyFirst), on="infra_1", at=0.3, until=0.7)]

    run = Run(tiny(edit=edit))
    assert not run.failures
    sent = [message.header.frame for message in run.decoded("agent/infra_1/tracks", "tracks")]
    assert [frame for frame in sent if frame not in received(run, "agent/infra_1/tracks")] == [4, 5, 6]


def test_a_rule_of_a_users_file_reaches_every_process(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(OWN_RULE)
    path, content = scenario.load(str(tmp_path / "mine.py"))
    resolved = scenario.resolve(path, content, frames=30)
    assert str(tmp_path / "mine.py") in resolved.modules
    rule = dict(type="EveryNth", n=3, at=0.5, until=2.0)
    assert resolved.nodes["link_infra_1"].config == dict(agent="infra_1", rules_up=[rule], rules_down=[rule])


def test_rules_of_one_fault_act_in_order_on_messages_and_on_detections() -> None:
    blind = dict(type="BlindSector", azimuth_min_deg=-180.0, azimuth_max_deg=180.0)

    def edit(content: dict) -> None:
        content["faults"] = [dict(type="Impair", rule=[dict(type="Cut"), blind], on="infra_1", at=0.3, until=0.6)]

    run = Run(tiny(edit=edit))
    assert set(range(12)) - set(received(run, "agent/infra_1/tracks")) >= {3, 4, 5}
    detections = run.decoded("agent/infra_1/detections", "detections")
    assert [message.header.frame for message in detections if not len(message.body["position"])] == [3, 4, 5]
