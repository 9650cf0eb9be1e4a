"""Runs with drivers: exact under any order, and what an attack does to a car that reacts."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from driven import driven, over_a_rough_link
from tiny_world import Run

from mast_zenoh.errors import ConfigurationError

GHOST = ("attack=GhostAhead", "attack_start_s=0.8")
SEIZED = ("attack=SeizedCommands", "attack_start_s=1.0")


@cache
def played(*settings: str, rough: bool = False) -> Run:
    run = Run(driven(*settings, edit=over_a_rough_link if rough else None))
    assert not run.failures
    return run


def veto(content: dict[str, Any]) -> None:
    """Let the ego's own sensors overrule its mission estimate."""
    content["drivers"]["ego"]["veto"] = True


def speeds(run: Run) -> np.ndarray:
    return np.array([np.hypot(*pose.body["velocity"][:2]) for pose in run.decoded("agent/ego/pose", "pose")])


def test_a_ghost_ahead_slows_the_car_and_the_twin_without_it_is_the_same_before() -> None:
    honest, attacked = played(), played(*GHOST)
    before = [list(run.messages["scene/truth"][:9]) for run in (honest, attacked)]
    assert before[0] == before[1], "the same seed, the same world"
    assert speeds(attacked)[-1] < speeds(honest)[-1] - 1.0


@pytest.mark.heavy
def test_a_ghost_in_the_picture_does_nothing_to_a_driver_that_trusts_its_own_tracks_alone() -> None:
    honest, attacked = played("estimate=safety"), played("estimate=safety", *GHOST)
    assert honest.messages["scene/truth"] == attacked.messages["scene/truth"]


def test_with_a_veto_the_car_goes_on_where_it_sees_that_there_is_no_ghost() -> None:
    believing, seeing = played(*GHOST), Run(driven(*GHOST, edit=veto))
    assert not seeing.failures
    assert not seeing.rejected
    assert speeds(seeing)[-1] > speeds(believing)[-1] + 1.0


def test_seized_commands_act_on_the_car_and_end() -> None:
    run = played(*SEIZED)
    told, carried = (run.decoded(key, "command") for key in ("agent/ego/command/@tap/0", "agent/ego/command"))
    forged = [
        k
        for k, (a, b) in enumerate(zip(told, carried, strict=True))
        if a.body["acceleration"] != b.body["acceleration"]
    ]
    assert forged == list(range(10, 24))
    speed = speeds(run)
    assert (np.diff(speed[10:]) <= 0.0).all()
    assert (run.decoded("attack/adversary_1/report", "attack_report"))[-1].header.frame == 23


def test_lost_and_late_commands_are_held_then_the_car_brakes_and_that_is_counted() -> None:
    run = played(rough=True)
    counts = run.results["simulator"]["commands"]["ego"]
    assert counts["commanded"] + counts["held"] + counts["braked"] == 24 - 1 - 4
    assert counts["held"] > 0
    assert counts["braked"] > 0


@pytest.mark.heavy
def test_a_second_driver_of_the_same_design_does_not_change_the_random_numbers_of_others() -> None:
    def two(content: dict[str, Any]) -> None:
        content["scene"] = content["scene"] | dict(n_mobile=1)

    def driving(content: dict[str, Any]) -> None:
        two(content)
        content["drivers"] = content["drivers"] | dict(mobile_1=dict(driver=dict(type="FollowingDriver")))

    one, both = Run(driven(edit=two, frames=6)), Run(driven(edit=driving, frames=6))
    assert one.messages["agent/infra_1/detections"][:5] == both.messages["agent/infra_1/detections"][:5]
    assert "agent/mobile_1/command" in both.messages


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (dict(drivers=dict(infra_1=dict())), r"drivers: 'infra_1'.*scene"),
        (dict(drivers=dict(ego="fast")), r"drivers\.ego.*'fast'.*dict"),
        (dict(drivers={}), r"world: .*take_over_s.*`drivers`"),
        (dict(world=dict(frames=3)), r"world\.frames.*follows.*scenario"),
        (dict(scene=dict(type="TinyScene"), world={}), r"TinyScene.*stepped.*Intersection"),
        (dict(drivers=dict(ego=dict(driver=dict(type="Folowing")))), r"'Folowing'.*FollowingDriver"),
        (dict(drivers=dict(ego=dict(driver=dict(type="FollowingDriver"), estimate="picture"))), "found 'picture'"),
        (dict(scene=dict(type="Intersection", sensors={"ego": [dict(type="Lidar", rate_hz=5.0)]})), "ego/lidar meas"),
    ],
    ids=lambda value: None if isinstance(value, dict) else value[:20],
)
def test_a_scenario_that_cannot_be_driven_is_refused(change: dict[str, Any], reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason):
        driven(edit=lambda content: content.update(change), frames=4)
