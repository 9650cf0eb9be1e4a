"""Each attack on the road ahead of a driven ego reaches its aim, by what happened to the car and to its twin."""

from functools import cache
from pathlib import Path
from typing import Any

import pytest

from mast_zenoh import scenario
from mast_zenoh.config import loading
from mast_zenoh.mesh.inproc import InProcess

pytestmark = [pytest.mark.heavy, pytest.mark.long]

#: The driver of the study, which keeps up with the traffic.
DRIVER = loading.module(Path("studies/driving.py")).DRIVER


@cache
def metrics_of(junction: int, seed: int, *settings: str) -> dict[str, Any]:
    """metrics.json of 15 s with attacks from 2 s on. No false detection lasts: cars would brake for those, too."""
    path, content = scenario.load(
        "driving", [f"scene_index={junction}", f"driver={DRIVER}", "attack_start_s=2.0", *settings]
    )
    content["scene"]["detector"] = dict(type="DetectionModel", white=True)
    process = InProcess(scenario.resolve(path, content, seed=seed, frames=150, record=False))
    metrics: dict[str, Any] = process.run()["evaluator"]["metrics"]
    assert not process.failures()
    return metrics


def driven(junction: int, seed: int, *settings: str) -> dict[str, Any]:
    """What happened to the ego."""
    ego: dict[str, Any] = metrics_of(junction, seed, *settings)["driven"]["ego"]
    return ego


@pytest.mark.parametrize(
    ("attack", "junction", "seed"),
    [("ghost_ahead", 5, 2), ("phantom_queue", 5, 2), ("cut_in", 5, 2), ("stale_picture", 5, 2), ("intruder", 5, 0)],
)
def test_an_ego_brakes_hard_for_what_is_not_there_and_its_twin_does_not(attack: str, junction: int, seed: int) -> None:
    attacked, twin = driven(junction, seed, f"attack={attack}"), driven(junction, seed)
    assert twin["needless_brakes"] == twin["hard_brakes"] == 0
    assert attacked["needless_brakes"] >= 1
    assert attacked["hard_brakes"] >= 1
    assert attacked["progress_m"] < twin["progress_m"] - 15.0
    causes = [brake["cause"] for brake in attacked["brakes"]]
    assert {"false"} <= {cause["kind"] for cause in causes}
    assert {"adversary_1"} <= {cause["adversary"] for cause in causes}


def test_a_queue_stops_the_ego_for_as_long_as_it_stands() -> None:
    attacked, twin = driven(4, 0, "attack=phantom_queue"), driven(4, 0)
    assert attacked["blocked_s"] > 2.0 > twin["blocked_s"]


def test_a_ghost_at_the_bumper_stops_a_car_unless_the_centre_or_the_driver_is_defended() -> None:
    ghost = [f"attack={Path('tests/attacks/agreeing_liars.py').resolve()}:AtBumper", "wire=tracks", "n_adversaries=1"]
    way_m = {
        name: driven(4, 0, *settings)["progress_m"]
        for name, settings in {
            "no attack": (),
            "undefended": ghost,
            "centre": (*ghost, "defence=FaultOrLie"),
            "driver": (*ghost, "veto=true"),
        }.items()
    }
    assert way_m["undefended"] < 0.6 * way_m["no attack"]
    assert way_m["centre"] > 0.8 * way_m["no attack"]
    assert way_m["driver"] > 0.95 * way_m["no attack"]


#: Where the ego comes up to a leader: junction, seed, settings. In dense traffic, no displaced leader is hit so far.
LEADERS: dict[str, tuple[int, int, tuple[str, ...]]] = {
    "hidden_leader": (7, 0, ()),
    "displaced_leader": (13, 0, ("scene.dense=False",)),
}


@pytest.mark.parametrize("attack", LEADERS)
def test_an_ego_hits_the_leader_that_it_does_not_see_and_its_twin_does_not(attack: str) -> None:
    junction, seed, settings = LEADERS[attack]
    attacked, twin = driven(junction, seed, *settings, f"attack={attack}"), driven(junction, seed, *settings)
    assert [hit["hidden"] for hit in attacked["collisions"]] == [True]
    assert twin["collisions"] == []


@pytest.mark.parametrize(("attack", "wire"), [*zip(LEADERS, ["picture", "detections"], strict=True)])
def test_one_of_both_sources_is_enough_to_keep_the_leader(attack: str, wire: str) -> None:
    junction, seed, settings = LEADERS[attack]
    assert driven(junction, seed, *settings, f"attack={attack}", f"wire={wire}")["collisions"] == []


def test_hidden_crossers_are_missing_in_what_the_ego_gets_and_nobody_is_hit_where_the_route_knows_where_to_wait():
    metrics = metrics_of(14, 1, "attack=hidden_crosser")
    assert metrics["achieved"]["all"]["hidden"] >= 1
    assert metrics["achieved"]["all"]["success_ego"] is True
    assert metrics["driven"]["ego"]["collisions"] == []


def test_own_sensors_or_a_defence_of_the_centre_protect_from_a_queue_where_they_can_see_it() -> None:
    twin = driven(4, 0)["progress_m"]
    assert driven(4, 0, "attack=phantom_queue", "veto=True")["progress_m"] > twin - 15.0
    on_tracks = ("attack=phantom_queue", "wire=tracks")
    assert driven(4, 0, *on_tracks)["progress_m"] < twin - 15.0
    assert driven(4, 0, *on_tracks, "defence=FaultOrLie")["progress_m"] > twin - 15.0
    on_downlink = driven(4, 0, "attack=phantom_queue", "defence=FaultOrLie")
    assert on_downlink["progress_m"] < twin - 15.0, "the centre does not see what happens to its picture"
