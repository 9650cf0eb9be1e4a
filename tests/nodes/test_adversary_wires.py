"""An adversary on poses and views, on the wires of several agents, and one that listens."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from tiny_world import Bench, Run, pose, tiny, tracks

from mast_zenoh.arrays.states import ObjectStates
from mast_zenoh.attacks import ACTIONS, Attack, Tampering, Targets, alter
from mast_zenoh.attacks.knowledge import Trust
from mast_zenoh.attacks.targets import ViewForger
from mast_zenoh.errors import ConfigurationError, WiringError
from mast_zenoh.integrity import SweptView
from mast_zenoh.integrity.views import view_columns
from mast_zenoh.tracking.view import SensorView

PLACES = ((10.0, 0.0), (20.0, 5.0), (15.0, -8.0))
REWRITES = ("on_pose.toml", "on_tracks.toml", "on_view.toml", "views.toml")


class HideFirst(Attack):
    """Hides the nearest object, shifts the pose by a metre, and keeps what it hears."""

    def __init__(self) -> None:
        self.forger = ViewForger()
        self.heard: list[tuple[str, int]] = []
        self.heard_at: list[tuple[int, int]] = []

    def hear_picture(self, frame: int, time_ns: int, objects: ObjectStates) -> None:
        self.heard.append(("picture", frame))

    def hear_trust(self, frame: int, time_ns: int, trust: Trust) -> None:
        self.heard.append(("trust", frame))

    def step(
        self,
        frame: int,
        time_ns: int,
        objects: ObjectStates,
        agent_position: np.ndarray,
        directive: Targets | None = None,
    ) -> Tampering:
        self.heard_at.append((frame, max((about for _, about in self.heard), default=-1)))
        if len(objects) == 0:
            return Tampering.nothing(0)
        nearest = int(np.argmin(np.linalg.norm(objects.position - agent_position, axis=1)))
        tampering = alter(objects, hide=[nearest])
        self.forger.remember(frame, objects, tampering)
        return tampering

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        return self.forger.forge(frame, swept)

    def forge_pose(self, frame: int, time_ns: int, position: np.ndarray) -> np.ndarray:
        return position + np.array([1.0, 0.0, 0.0])


def attacked(*more: str, agent: Any = "infra_1", rewrites: tuple[str, ...] = REWRITES) -> Any:
    """A scenario change: one adversary on these wires of an agent."""

    def change(scenario: dict[str, Any]) -> None:
        scenario["adversaries"] = {"adversary_1": dict(agent=agent, attack=dict(type="HideFirst"))}
        scenario["keyexpr"] = dict(rewrites=[*rewrites, *more])

    return change


@pytest.fixture(scope="module")
def resolved():
    return tiny(edit=attacked())


def view(**changes: Any) -> dict[str, np.ndarray]:
    """Columns of a view of a sensor 5 m above the origin."""
    sensor = SensorView(np.array([0.0, 0.0, 5.0]), np.eye(3), -np.pi, np.pi, -1.0, 0.5, 80.0)
    return view_columns(sensor, np.full((16, 180), 40.0)) | changes


def test_an_agent_gets_the_forged_pose_and_everybody_else_the_true_one() -> None:
    run, plain = Run(tiny(edit=attacked())), Run(tiny(edit=lambda s: s.update(keyexpr=dict(rewrites=["views.toml"]))))
    assert not run.failures
    assert run.messages["agent/infra_1/pose"] == plain.messages["agent/infra_1/pose"]
    true = run.decoded("agent/infra_1/pose", "pose")
    forged = run.decoded("agent/infra_1/pose/@tap/infra_1/0", "pose")
    assert [each.header for each in forged] == [each.header for each in true]
    for one, other in zip(true, forged, strict=True):
        np.testing.assert_allclose(other.body["position"] - one.body["position"], [1.0, 0.0, 0.0])
        for name in ("rotation", "velocity"):
            np.testing.assert_array_equal(one.body[name], other.body[name])
    assert run.messages["agent/ego/tracks"] == plain.messages["agent/ego/tracks"]
    tapped = run.decoded("agent/infra_1/tracks/@tap/0", "tracks")[-1].body
    honest = plain.decoded("agent/infra_1/tracks", "tracks")[-1].body
    np.testing.assert_allclose(tapped["position"] - honest["position"], np.tile([1.0, 0.0, 0.0], (4, 1)), atol=1e-6)
    interposers = run.results["evaluator"]["metrics"]["interposers"]
    assert interposers["adversary_1"]["agreement"] == "agrees"
    assert interposers["adversary_1"]["effects"]["reframed"] >= 12


@pytest.mark.parametrize("view_first", [True, False])
def test_a_view_agrees_with_the_tracks_of_its_frame_in_any_order_of_arrival(resolved, view_first: bool) -> None:
    adversary = Bench(resolved, "adversary_1")
    blocked = np.full((16, 180), 40.0)
    blocked[:, 88:92] = 8.0
    for frame in range(2):
        adversary.play(frame, pose=pose())
        if view_first:
            assert adversary.send("view", view(free=blocked), frame) == []
        adversary.send("tracks", tracks(*PLACES), frame)
        if not view_first:
            adversary.send("view", view(free=blocked), frame)
    views = adversary.heard("agent/infra_1/view")
    assert [message.header.frame for message in views] == [0, 1]
    for message in views:
        assert message.body["free"][6, 90] > 12.0, "the car 10 m ahead is hidden"
        assert message.body["free"][6, 0] == 40.0
    reports = adversary.heard("attack/adversary_1/report")
    actions = [ACTIONS[action] for message in reports for action in message.body["action"]]
    assert actions == ["reframed", "removed", "reframed"] * 2, "pose, tracks, view"


class MoveView(HideFirst):
    """Claims another place of the sensor, and leaves its free space."""

    def forge_view(self, frame: int, time_ns: int, swept: SweptView) -> SweptView:
        return replace(swept, view=replace(swept.view, position=swept.view.position + 2.0, max_range=60.0))


def test_an_attack_may_forge_everything_in_a_view() -> None:
    def moved(scenario: dict[str, Any]) -> None:
        attacked()(scenario)
        scenario["adversaries"]["adversary_1"]["attack"] = dict(type="MoveView")

    run = Run(tiny(edit=moved))
    true, forged = (run.decoded(f"agent/infra_1/view{tap}", "view")[-1].body for tap in ("/@tap/0", ""))
    np.testing.assert_allclose(forged["position"] - true["position"], [2.0, 2.0, 2.0])
    assert forged["max_range"].tolist() == [60.0]
    np.testing.assert_array_equal(forged["free"], true["free"])
    interposer = run.results["evaluator"]["metrics"]["interposers"]["adversary_1"]
    assert interposer["agreement"] == "agrees"
    assert interposer["effects"]["reframed"] > 0


def test_a_view_without_tracks_is_forwarded_unchanged_at_the_next_clock(resolved) -> None:
    adversary = Bench(resolved, "adversary_1")
    adversary.play(0, pose=pose())
    assert adversary.send("view", view(), 0) == []
    published = adversary.clock(1)
    assert [key for key, _ in published] == ["agent/infra_1/view"]
    np.testing.assert_array_equal(published[0][1].body["free"], view()["free"])


@pytest.mark.parametrize(
    "flaw",
    [
        dict(azimuth=np.array([1.0, -1.0])),
        dict(elevation=np.array([0.0, 9.0])),
        dict(max_range=np.array([-1.0])),
        dict(free=np.full((2, 2), -1.0)),
    ],
)
def test_an_implausible_view_is_forwarded_unchanged(resolved, flaw: dict[str, np.ndarray]) -> None:
    adversary = Bench(resolved, "adversary_1")
    adversary.play(0, pose=pose(), tracks=tracks(*PLACES))
    ((_, sent),) = adversary.send("view", view(**flaw), 0)
    for name, column in flaw.items():
        np.testing.assert_array_equal(sent.body[name], column)
    assert not adversary.host.failures


finite = st.floats(-1e9, 1e9)


@given(st.data())
def test_no_view_that_passes_the_checks_of_its_type_makes_an_adversary_fail(resolved, data: st.DataObject) -> None:
    adversary = Bench(resolved, "adversary_1")
    adversary.play(0, pose=pose(), tracks=tracks(*PLACES))
    shape = data.draw(st.tuples(st.integers(0, 5), st.integers(0, 7)))
    flaws = dict(
        position=data.draw(arrays.arrays(np.float64, 3, elements=finite)),
        azimuth=data.draw(arrays.arrays(np.float64, 2, elements=finite)),
        elevation=data.draw(arrays.arrays(np.float64, 2, elements=st.floats(-3.0, 3.0))),
        max_range=data.draw(arrays.arrays(np.float64, 1, elements=finite)),
        free=data.draw(arrays.arrays(np.float64, shape, elements=finite)),
    )
    chosen = data.draw(st.sets(st.sampled_from(sorted(flaws))))
    published = adversary.send("view", view(**{name: flaws[name] for name in chosen}), 0)
    assert not adversary.host.failures
    assert [key for key, _ in published if key.endswith("view")] == ["agent/infra_1/view"]


def test_what_an_adversary_overhears_counts_from_the_next_frame_on() -> None:
    listening = tiny("defended", edit=attacked("knowledge_picture.toml", "knowledge_trust.toml"))
    run = Run(listening)
    assert not run.failures
    attack = run.nodes["adversary_1"].attack
    assert {name for name, _ in attack.heard} == {"picture", "trust"}
    assert attack.heard_at == [(frame, frame - 1) for frame in range(12)]
    for shuffle in (1, 2):
        assert Run(listening, shuffle=shuffle).messages == run.messages


def test_one_adversary_attacks_several_agents_as_adversaries_of_their_own_would() -> None:
    resolved = tiny(edit=attacked(agent=["infra_1", "infra_2"]))
    several = Run(resolved)
    assert not several.failures
    for shuffle in (1, 2, 3):
        assert Run(resolved, shuffle=shuffle).messages == several.messages

    def apart(scenario: dict[str, Any]) -> None:
        attacked()(scenario)
        one = scenario["adversaries"]["adversary_1"]
        scenario["adversaries"]["adversary_2"] = one | dict(agent="infra_2")

    each = Run(tiny(edit=apart))
    for key in ("agent/infra_1/tracks", "agent/infra_2/tracks", "agent/infra_1/view", "agent/infra_2/view"):
        assert several.messages[key] == each.messages[key], key
    assert several.messages["cc/picture"] == each.messages["cc/picture"]
    assert several.results["evaluator"]["metrics"]["interposers"]["adversary_1"]["agreement"] == "agrees"


@pytest.mark.parametrize(
    ("agent", "rewrites", "acting", "error", "reason"),
    [
        (["infra_1", "infra_2"], ("on_picture.toml",), True, WiringError, "must name"),
        (
            *("infra_1", ("on_picture.toml",), False, WiringError),
            r"before infra_1, but 'cc/picture' leads to ego \(agents\.infra_1\.acts=true",
        ),
        (["infra_1", "infra_1"], REWRITES, False, ConfigurationError, "agent"),
        (
            *(["infra_1", "infra_9"], REWRITES, False, ConfigurationError),
            r"adversary_1\.agent: no agent 'infra_9' in this scene",
        ),
    ],
)
def test_an_impossible_choice_of_agents_is_refused_with_the_reason(agent, rewrites, acting, error, reason) -> None:
    with pytest.raises(error, match=reason):
        tiny(edit=attacked(agent=agent, rewrites=rewrites), acting=acting)


def test_a_coordinated_adversary_has_one_agent() -> None:
    def both(scenario: dict[str, Any]) -> None:
        scenario["adversaries"]["adversary_1"]["agent"] = ["infra_1", "infra_2"]

    with pytest.raises(ConfigurationError, match=r"adversary_1\.agent.*infra_1, infra_2"):
        tiny("coordinated", "n_adversaries=1", edit=both)


def test_an_attack_that_returns_nothing_is_named(resolved, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(HideFirst, "step", lambda *_: None)
    adversary = Bench(resolved, "adversary_1")
    adversary.play(0, pose=pose(), tracks=tracks(*PLACES))
    (failure,) = adversary.host.failures.values()
    assert "HideFirst.step returned NoneType" in failure.exception
