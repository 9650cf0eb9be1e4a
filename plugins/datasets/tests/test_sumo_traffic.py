"""Traffic that SUMO simulates while it is played: exact, reacting to driven cars, and harmless if its files are bad."""

from __future__ import annotations

import contextlib
import gc
import json
import os
import signal
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import cast
from xml.etree import ElementTree

import numpy as np
import psutil
import pytest
from damages import DAMAGE, Damage, damaged, text
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mast_datasets import SumoTraffic, sumo_simulation
from mast_datasets.sumo_traffic import SumoWorld
from sumo_network import vehicle, write_network

from mast_zenoh import scenario
from mast_zenoh.arrays.geometry import heading
from mast_zenoh.driving import Command, FollowingDriver, Situation
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.launch import run as launcher
from mast_zenoh.scenes.making.observe import World
from mast_zenoh.sensing import CleanDetector
from mast_zenoh.testing import check_scene

pytestmark = [
    pytest.mark.heavy,
    pytest.mark.skipif(find_spec("libsumo") is None, reason="SUMO is not installed (pip install 'mast-zenoh[sumo]')"),
]
#: Two cars eastward, the second behind the first, and one northward that has to give way.
TRAFFIC = "\n".join(
    [vehicle("11", "eastward", 0, 200), vehicle("north", "northward", 0, 480), vehicle("12", "eastward", 3, 200)]
)


def scene(path: Path, **parameters: object) -> SumoTraffic:
    usual = dict(n_infrastructure=0, start_s=5.0, ego="11", radius_m=1000.0, detector=CleanDetector())
    return SumoTraffic(path=str(path), **usual | parameters)  # type: ignore[arg-type]


@pytest.fixture
def crossing(tmp_path: Path) -> Path:
    """A crossing with right of way and three cars."""
    return write_network(tmp_path / "crossing", traffic=TRAFFIC)


def world(scene: SumoTraffic, frames: int = 150) -> contextlib.closing[SumoWorld]:
    return contextlib.closing(cast("SumoWorld", scene.world(0, frames)))


def children() -> set[int]:
    return {child.pid for child in psutil.Process().children(recursive=True)}


def speed_of(present: World, number: int) -> float:
    return float(np.hypot(*present.truth.velocity[present.truth.id == number][0, :2]))


def drive(world: SumoWorld, car: str = "ego") -> Command:
    """What the shipped driver does that knows the truth."""
    present = world.now()
    row = [agent.name for agent in present.agents].index(car)
    own = present.truth.id == present.agents[row].object_id
    return FollowingDriver().drive(
        Situation(
            time_ns=0,
            position=present.agent_position[0, row],
            velocity=present.agent_velocity[0, row],
            heading=float(heading(present.agent_rotation[0, row])),
            size=world.size(car),
            route=world.route(car),
            objects=present.truth.select(np.flatnonzero(~own)),
        )
    )


def test_recordings_are_repeatable_and_shorter_ones_are_their_beginning(crossing: Path) -> None:
    check_scene(scene(crossing, n_mobile=1, n_infrastructure=2))
    short, long = (scene(crossing).record(0, frames) for frames in (3, 6))
    np.testing.assert_array_equal(short.truth_at(2).position, long.truth_at(2).position)


def test_a_world_without_commands_is_the_recording_also_when_drivers_look_at_it(crossing: Path) -> None:
    recording = scene(crossing).record(0, 40)
    with world(scene(crossing)) as stepped:
        for frame in range(40):
            present, expected = stepped.now().truth, recording.truth_at(frame)
            for column in ("id", "position", "velocity", "yaw"):
                np.testing.assert_array_equal(getattr(present, column), getattr(expected, column))
            stepped.route("ego")
            stepped.step({})


def test_worlds_in_one_process_do_not_disturb_each_other(crossing: Path) -> None:
    alone = list(played(scene(crossing), 20))
    with world(scene(crossing, ego="12")) as other:
        beside = []
        for state in played(scene(crossing), 20):
            beside.append(state)
            other.step({"ego": Command(-3.0, 0.0)})
    np.testing.assert_array_equal(alone, beside)


def played(scene: SumoTraffic, frames: int) -> Iterator[np.ndarray]:
    """The positions of frames in which the ego brakes."""
    with world(scene) as stepped:
        for _ in range(frames):
            stepped.step({"ego": Command(-1.0, 0.0)})
            yield stepped.now().truth.position


def test_a_car_that_brakes_is_followed_by_one_that_stops_behind_it(crossing: Path) -> None:
    with world(scene(crossing), 150) as stepped:
        assert speed_of(stepped.now(), 12) > 9.0
        for _ in range(150):
            stepped.step({"ego": Command(-3.0, 0.0)})
        present = stepped.now()
    assert speed_of(present, 11) == 0.0
    assert speed_of(present, 12) < 0.3
    first, second = (present.truth.position[present.truth.id == number][0] for number in (11, 12))
    assert 4.5 < first[0] - second[0] < 12.0


def test_a_driven_car_does_exactly_what_it_is_told(crossing: Path) -> None:
    with world(scene(crossing)) as stepped:
        before = stepped.now()
        for _ in range(10):
            stepped.step({"ego": Command(-9.0, 0.02)})
        after = stepped.now()
        for _ in range(40):
            stepped.step({})
        assert speed_of(stepped.now(), 11) > speed_of(after, 11) + 3.0, "it drives itself again"
    speed = speed_of(before, 11)
    assert speed_of(after, 11) == pytest.approx(speed - 9.0)
    way = speed * 1.0 - 9.0 / 2.0
    turned = float(heading(after.agent_rotation[0, 0]) - heading(before.agent_rotation[0, 0]))
    assert turned == pytest.approx(0.02 * way)
    moved = np.linalg.norm(after.agent_position[0, 0] - before.agent_position[0, 0])
    assert moved == pytest.approx(2.0 / 0.02 * np.sin(0.02 * way / 2.0))


def test_a_driven_car_gives_way_and_others_give_way_to_it(tmp_path: Path) -> None:
    """Both would be at the crossing at the same time, and the next one eastward 3 s later."""
    cars = [vehicle("11", "eastward", 0, 450), vehicle("20", "northward", 0, 480), vehicle("12", "eastward", 3, 450)]
    path = write_network(tmp_path, traffic="\n".join(cars))
    for ego, yields in (("20", True), ("11", False)):
        slowest = np.inf
        with world(scene(path, ego=ego, start_s=2.0)) as stepped:
            for _ in range(120):
                stepped.step({"ego": drive(stepped)})
                present = stepped.now()
                slowest = min(slowest, float(np.hypot(*present.agent_velocity[0, 0, :2])))
                own = present.truth.id == present.agents[0].object_id
                distance = np.linalg.norm(present.truth.position[~own] - present.agent_position[0, 0], axis=1)
                assert distance.min() > 3.0
        assert (slowest < 8.0) == yields


def test_a_driven_car_stops_at_a_red_light_and_goes_at_green(tmp_path: Path) -> None:
    lights = '<phase duration="30" state="Gr"/><phase duration="300" state="rG"/>'
    path = write_network(tmp_path / "lights", lights, vehicle("11", "eastward", 0, 400))
    with world(scene(path), 400) as stepped:
        line = stepped.route("ego").stop_m
        assert np.isinf(line) or line < 80.0
        waited = []
        for _ in range(400):
            stepped.step({"ego": drive(stepped)})
            waited.append(stepped.route("ego").stop_m)
        assert min(waited) < 2.0
        present = stepped.now()
    assert speed_of(present, 11) > 5.0
    assert np.isinf(waited[-1])


def test_a_car_beside_the_road_does_not_stop_the_traffic_nor_the_run(crossing: Path) -> None:
    with world(scene(crossing), 150) as stepped:
        for frame in range(150):
            stepped.step({"ego": Command(0.0, 0.1 if frame < 30 else 0.0)})
            stepped.route("ego")
        present = stepped.now()
    assert speed_of(present, 12) > 10.0
    assert abs(present.agent_position[0, 0, 1]) > 20.0


def test_ids_do_not_depend_on_what_happens(crossing: Path) -> None:
    recording = scene(crossing).record(0, 2)
    numbers = recording.truth_at(0).id.tolist()
    assert numbers[:2] == [11, 12]
    assert 500_000_000 <= numbers[2] < 1_000_000_000, "pages show ids below 2**30 as they are"
    assert scene(crossing, ego="north").record(0, 2).truth_at(0).id.tolist() == numbers


def test_objects_are_there_within_the_radius_of_an_agent(crossing: Path) -> None:
    near = scene(crossing, radius_m=60.0).record(0, 60)
    far = scene(crossing, radius_m=1000.0).record(0, 60)
    assert len(near.truth) < len(far.truth)
    for frame in range(60):
        offset = near.truth_at(frame).position - near.agent_position[frame, 0]
        assert np.hypot(*offset[:, :2].T).max() <= 60.0


@pytest.mark.parametrize(
    ("frames", "parameters", "problem"),
    [
        (2, dict(ego="nobody"), "at 5 s: ego is 'nobody', expected a car that drives on for 15 s; the cars are 11"),
        (2, dict(n_mobile=9), "n_mobile is 9, expected 0 to 2"),
        (2, dict(start_s=0.0, ego=None), "found 0 cars, expected a car that drives on"),
        (1000, dict(ego=None), "expected a car that drives on for 100 s"),
    ],
)
def test_cars_that_are_not_there_are_refused(crossing: Path, frames: int, parameters: dict, problem: str) -> None:
    before = children()
    with pytest.raises((ConfigurationError, SceneError), match=problem):
        scene(crossing, **parameters).record(0, frames)
    assert children() <= before


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (text("crossing.rou.xml", 'edges="west east"', 'edges="west nowhere"'), "SUMO refuses it: .*'nowhere'"),
        (text("crossing.net.xml", 'to="C"', 'to="D"', 9), "'D'"),
        (text("crossing.net.xml", 'shape="-600,0 -4,0"', 'shape="-600,0 nan,0"'), "crossing.sumocfg: "),
        (text("crossing.rou.xml", 'length="4.5"', 'length="nan"'), "rou.xml: line 3: <vType>: length: found "),
        (text("crossing.rou.xml", 'length="4.5"', 'length="1e7"'), "crossing.sumocfg: .*: found "),
    ],
)
def test_what_cannot_be_simulated_is_refused_in_sumos_words(crossing: Path, damage: Damage, message: str) -> None:
    before = children()
    damage.apply(crossing.parent)
    with pytest.raises(SceneError, match=message):
        scene(crossing).record(0, 40)
    assert children() <= before


def test_a_simulation_that_dies_or_hangs_is_an_error(crossing: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = children()
    stepped = scene(crossing).world(0, 20)
    (process,) = children() - before
    os.kill(process, signal.SIGKILL)
    with pytest.raises(SceneError, match=r"crossing\.sumocfg: SUMO ended with exit code -9"):
        stepped.step({})
    monkeypatch.setattr(sumo_simulation, "_STEP_S", 1)
    monkeypatch.setattr(sumo_simulation, "_GRACE_S", 0.5)
    stepped = scene(crossing).world(0, 20)
    (process,) = children() - before
    os.kill(process, signal.SIGSTOP)
    with pytest.raises(SceneError, match="SUMO took longer than 1 s"):
        stepped.step({})
    assert children() <= before


def test_a_request_that_takes_too_long_ends_within_sumo_itself(crossing: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sumo_simulation._LIMITS_S, "advance", 1)
    flow = '<flow id="f" type="steady" route="eastward" begin="0" end="10000000" period="2" departPos="0"/></routes>'
    text("crossing.rou.xml", "</routes>", flow).apply(crossing.parent)
    with pytest.raises(SceneError, match="SUMO took longer than 1 s"):
        scene(crossing, start_s=9_000_000.0).record(0, 2)


def test_no_process_stays_behind(crossing: Path) -> None:
    before = children()
    scene(crossing).record(0, 2)
    assert children() <= before
    forgotten = scene(crossing).world(0, 2)
    assert children() - before
    del forgotten
    gc.collect()
    assert children() <= before


def test_sumo_writes_no_file_that_its_inputs_name(crossing: Path, tmp_path: Path) -> None:
    target = tmp_path / "written.xml"
    output = f'</input><output><tripinfo-output value="{target}"/><fcd-output value="{target}"/></output>'
    device = f'<param key="has.ssm.device" value="true"/><param key="device.ssm.file" value="{target}"/></vType>'
    detector = f'<e1Detector id="d" lane="west_0" pos="100" freq="1" file="{target}"/></routes>'
    text("crossing.sumocfg", "</input>", output).apply(crossing.parent)
    text("crossing.rou.xml", 'speedDev="0"/>', f'speedDev="0">{device}').apply(crossing.parent)
    text("crossing.rou.xml", "</routes>", detector).apply(crossing.parent)
    before = sorted(tmp_path.rglob("*"))
    scene(crossing).record(0, 20)
    assert sorted(tmp_path.rglob("*")) == before


def measured_twice(path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[dict, ElementTree.ElementTree]:
    """What a run tells of the ego, SUMO's vehicle 11, and what SUMO's own device does."""
    file = folder / "ssm.xml"
    device = ("--device.ssm.explicit", "11", "--device.ssm.measures", "TTC DRAC PET", "--device.ssm.file", str(file))
    device += ("--device.ssm.thresholds", "50 0.1 10", "--device.ssm.range", "100")
    monkeypatch.setattr(sumo_simulation, "_ALWAYS", (*sumo_simulation._ALWAYS, *device))
    settings = [f"scene=sumo:{path}", "scene.start_s=2.5", "scene.ego=11", "n_infrastructure=0", "estimate=truth"]
    resolved = scenario.resolve(*scenario.load("driving", settings), frames=150, seed=0, record=False)
    run = launcher.run(resolved, folder / "run", runtime="inproc")
    assert run.error is None
    gc.collect()  # SUMO writes its file when it ends
    return json.loads((run.folder / "metrics.json").read_text())["driven"]["ego"], ElementTree.parse(file)


def extremes(measured: ElementTree.ElementTree, foe: str, name: str, types: str = "") -> list[float]:
    """What the device found for each conflict with a foe; types: of conflicts, all if empty"""
    found = [
        each for conflict in measured.iter("conflict") if conflict.get("foe") == foe for each in conflict.iter(name)
    ]
    values = [each.get("value", "NA") for each in found if not types or each.get("type") == types]
    return [float(value) for value in values if value != "NA"]


def test_the_least_time_to_collision_and_the_braking_that_it_needs_are_those_of_sumos_own_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The device counts the car ahead on the lane; types 2: the car follows. Its numbers have two decimals."""
    slow = '<vehicle id="10" type="steady" route="eastward" depart="0" departPos="200" departSpeed="3"/>'
    slow = slow.replace("/>", '><stop lane="west_0" endPos="230" duration="200"/></vehicle>')
    path = write_network(tmp_path / "net", traffic=f"{slow}\n{vehicle('11', 'eastward', 2, 60, 13.0)}")
    ours, theirs = measured_twice(path, tmp_path, monkeypatch)
    assert ours["collisions"] == []
    assert 1.0 < ours["min_ttc_s"] < 15.0
    assert ours["min_ttc_s"] == pytest.approx(min(extremes(theirs, "10", "minTTC", "2")), abs=0.1)
    assert ours["max_drac_mps2"] == pytest.approx(max(extremes(theirs, "10", "maxDRAC", "2")), abs=0.1)


def test_the_post_encroachment_time_is_that_of_sumos_own_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ours is between whole frames of 0.1 s, so it is longer by up to two."""
    traffic = "\n".join([vehicle("11", "eastward", 0, 450), vehicle("north", "northward", 0, 480)])
    ours, theirs = measured_twice(write_network(tmp_path / "net", traffic=traffic), tmp_path, monkeypatch)
    assert -0.01 < ours["min_pet_s"] - min(extremes(theirs, "north", "PET")) < 0.21


@settings(max_examples=10, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_network_is_simulated_or_refused(crossing: Path, data: st.DataObject) -> None:
    files = sorted(crossing.parent.iterdir())
    file = data.draw(st.sampled_from(files))
    content = file.read_bytes()
    before = children()
    try:
        file.write_bytes(damaged(content, data.draw(DAMAGE)))
        with contextlib.suppress(SceneError, ConfigurationError):
            scene(crossing, ego=None).record(0, 3).validate()
    finally:
        file.write_bytes(content)
    assert children() <= before
