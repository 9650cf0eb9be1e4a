"""Scenarios of OPV2V and its relatives are read as they were written, and damaged ones are refused."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import opv2v_writer as writer
import pytest
from comparison import assert_same, junction, lidar_pose
from damages import Damage, assert_refused, content, removed, text, value
from mast_datasets import MultiV2XScene, OPV2VScene, V2V4RealScene, V2XRealScene

from mast_zenoh.errors import ConfigurationError
from mast_zenoh.scenes import Recording, Scene
from mast_zenoh.sensing import CleanDetector

FRAMES = 20
SHORT_NAMES = {OPV2VScene: "opv2v", V2XRealScene: "v2xreal", MultiV2XScene: "multiv2x", V2V4RealScene: "v2v4real"}
WRITERS: dict[type[Scene], Callable[[Recording, Path], Path]] = {
    OPV2VScene: writer.write_opv2v,
    V2XRealScene: writer.write_v2xreal,
    MultiV2XScene: writer.write_multiv2x,
    V2V4RealScene: writer.write_v2v4real,
}


@pytest.fixture(scope="session")
def original() -> Recording:
    """A junction with three cars and a pole as agents."""
    return junction(n_infrastructure=1, n_mobile=2, frames=FRAMES)


@pytest.fixture(scope="session")
def twins(original: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[type[Scene], Path]:
    folder = tmp_path_factory.mktemp("twins")
    return {cls: write(original, folder / SHORT_NAMES[cls] / "scenario") for cls, write in WRITERS.items()}


def read(cls: Callable[..., Scene], path: Path, **parameters: Any) -> Recording:
    return cls(path=str(path), detector=CleanDetector(), **parameters).record(0, None)


@pytest.mark.parametrize("cls", WRITERS, ids=lambda cls: cls.__name__)
def test_a_twin_is_read_back_with_what_its_agents_list(cls: type[Scene], twins: Any, original: Recording) -> None:
    twin = read(cls, twins[cls])
    expected = ("ego", "mobile_1") if cls is V2V4RealScene else ("ego", "mobile_1", "mobile_2", "infra_1")
    assert twin.agent_names == expected
    seen = original.points[:, : len(expected)]
    listed = np.ones(len(seen), np.bool_) if cls is MultiV2XScene else seen.max(axis=1) > 0
    cars = [agent.object_id for agent in twin.agents if agent.kind == "mobile"]
    bodies = cls in (OPV2VScene, MultiV2XScene)
    rows, columns = assert_same(twin, original, listed=listed, added=cars, bodies=bodies, all_cars=cls is OPV2VScene)
    for number in cars:
        assert np.count_nonzero(twin.truth.id == number) == FRAMES, "a car that nobody lists is there, too"
    if bodies:
        np.testing.assert_allclose(twin.agent_velocity, original.agent_velocity[:, [*columns.values()]], atol=0.5)
    if cls is MultiV2XScene:
        np.testing.assert_array_equal(twin.points[rows], seen[listed][:, [*columns.values()]])
    else:
        np.testing.assert_array_equal(twin.points[rows] >= 5, seen[listed][:, [*columns.values()]] > 0)
        assert not ((twin.points > 0) & (twin.points < 5)).any()


def test_a_scene_by_hand_has_y_to_the_left(tmp_path: Path) -> None:
    """A car that heads towards CARLA's y, which is to the right of x, with its nose 10 degrees up."""
    ahead = {"location": [10.0, 30.0, 1.0], "center": [0.0, 0.0, 0.5], "extent": [2.0, 1.0, 0.75], "angle": [0, 120, 0]}
    for frame in range(2):
        content = {
            "lidar_pose": [10.0, 20.0, 2.0, 0.0, 90.0, 10.0],
            "true_ego_pos": [10.0, 20.0, 0.0, 0.0, 90.0, 0.0],
            "vehicles": {7: ahead},
        }
        writer.write_yaml(tmp_path / "scenario" / "5" / f"{frame:06d}.yaml", content)
    scene = read(OPV2VScene, tmp_path)
    assert scene.truth_at(0).id.tolist() == [5, 7]
    np.testing.assert_allclose(scene.truth.position[:2], [[10.0, -20.0, 1.511 / 2], [10.0, -30.0, 1.5]])
    np.testing.assert_allclose(scene.truth.size[1], [4.0, 2.0, 1.5])
    np.testing.assert_allclose(np.degrees(scene.truth.yaw[:2]), [-90.0, -120.0])
    np.testing.assert_allclose(scene.agent_position[0, 0], [10.0, -20.0, 0.0])
    up = np.radians(10)
    np.testing.assert_allclose(scene.agent_rotation[0, 0, :, 0], [0.0, -np.cos(up), np.sin(up)], atol=1e-12)
    np.testing.assert_allclose(scene.agent_rotation[0, 0, :, 1], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(lidar_pose(scene, 0, 0)[0], [10.0, -20.0, 2.0], atol=1e-12)


def test_a_car_that_nobody_lists_has_the_usual_size(twins: Any, original: Recording) -> None:
    ego = original.agents[0].object_id
    for frame in range(5):
        assert original.points_at(frame)[original.truth_at(frame).id == ego].max() == 0
    twin = read(OPV2VScene, twins[OPV2VScene], ego=ego, last_frame=writer.FIRST + 8)
    assert twin.agents[0].object_id == ego
    rows = twin.truth.id == ego
    np.testing.assert_allclose(twin.truth.size[rows], np.tile([4.902, 2.128, 1.511], (5, 1)))
    centre = twin.agent_position[:, 0] + [0.0, 0.0, 1.511 / 2]
    np.testing.assert_allclose(twin.truth.position[rows], centre, atol=1e-9)


def test_agents_and_frames_can_be_chosen(twins: Any) -> None:
    whole = read(OPV2VScene, twins[OPV2VScene])
    part = read(OPV2VScene, twins[OPV2VScene], first_frame=72, last_frame=80, n_mobile=1, n_infrastructure=0)
    assert part.agent_names == ("ego", "mobile_1")
    assert len(part) == 5
    assert part.times_ns[0] == 0
    others = part.truth_at(0).id != 20  # a car that nobody lists until later, which has the usual size until then
    np.testing.assert_allclose(part.truth_at(0).position[others], whole.truth_at(2).position[others])
    assert read(OPV2VScene, twins[OPV2VScene], rate_hz=5).times_ns[1] == 200_000_000
    assert OPV2VScene(path=str(twins[OPV2VScene])).record(0, 3).times_ns.tolist() == [0, 100_000_000, 200_000_000]


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (dict(ego=7), "ego is 7, expected the number of a car: 6, 9, 20"),
        (dict(ego=-3), "ego is -3, expected the number of a car: 6, 9, 20"),
        (dict(first_frame=107), "6: first_frame is 107, last_frame is None: found no frame, .* some of 68 to 106"),
        (dict(first_frame=80, last_frame=70), "first_frame is 80, last_frame is 70: found no frame"),
    ],
)
def test_parameters_that_the_scenario_does_not_have_are_refused(twins: Any, parameters: Any, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        read(OPV2VScene, twins[OPV2VScene], **parameters)


def test_agents_of_multi_v2x_come_by_their_distance_and_one_that_leaves_is_an_object(
    twins: Any, tmp_path: Path
) -> None:
    scene = read(MultiV2XScene, twins[MultiV2XScene], ego=20)
    distance = np.linalg.norm(scene.agent_position[0, 1:3] - scene.agent_position[0, 0], axis=1)
    assert distance[0] < distance[1]
    folder = Path(shutil.copytree(twins[MultiV2XScene], tmp_path / "town"))
    for path in (folder / "cav_9" / "000106.yaml", *folder.glob("*/*_view.yaml")):
        path.unlink()
    scene = read(MultiV2XScene, folder)
    assert [agent.object_id for agent in scene.agents] == [6, 20, -1]
    assert 9 in scene.truth_at(19).id
    assert (scene.points >= 5).any(axis=0).all(), "rays are cast without view files"


def test_the_handedness_of_v2x_real_only_mirrors_the_scene(twins: Any) -> None:
    left, right = (read(V2XRealScene, twins[V2XRealScene], left_handed=value) for value in (True, False))
    np.testing.assert_allclose(right.truth.position, left.truth.position * [1.0, -1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(right.agent_position, left.agent_position * [1.0, -1.0, 1.0], atol=1e-9)
    np.testing.assert_array_equal(right.points > 0, left.points > 0)


def test_objects_of_v2v4real_without_an_association_get_ids_of_their_own(tmp_path: Path, original: Recording) -> None:
    alone = int(original.truth.id[np.flatnonzero((original.points[:, 0] > 0) & (original.points[:, 1] == 0))[0]])
    folder = writer.write_v2v4real(original, tmp_path / "s", alone=alone)
    scene = read(V2V4RealScene, folder)
    assert alone not in scene.truth.id
    place = original.truth.position[np.flatnonzero((original.truth.id == alone) & (original.points[:, 0] > 0))[0]]
    row = np.flatnonzero(np.linalg.norm(scene.truth.position - place, axis=1) < 1e-6)[0]
    assert scene.truth.id[row] > original.truth.id.max()


def test_an_object_that_is_associated_in_some_frames_keeps_that_id(twins: Any, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(twins[V2V4RealScene], tmp_path / "s"))
    for number in (3, 4):
        path = folder / "0" / f"{number:06d}.yaml"
        lines = path.read_text().split("\n")
        path.write_text("\n".join("    ass_id: -1" if "ass_id:" in line else line for line in lines))
    np.testing.assert_array_equal(
        read(V2V4RealScene, folder).truth.id, read(V2V4RealScene, twins[V2V4RealScene]).truth.id
    )


FILE = "6/000068.yaml"
VIEW = "cav_6/00068_view.yaml"


def without_folders(*names: str) -> Damage:
    return Damage("", lambda folder: [shutil.rmtree(folder / name) for name in names])


def view(*entries: tuple[int, int]) -> Damage:
    return value(VIEW, "visible_objects", [{"object_id": one, "visible_points": n} for one, n in entries])


def moved(metres: float, frame: str, agents: tuple[str, ...] = ("6", "9", "20", "-3")) -> Damage:
    """Object 10 elsewhere in the files of the agents."""

    def change(folder: Path) -> None:
        for agent in agents:
            if "  10:" in (folder / agent / frame).read_text():
                value(f"{agent}/{frame}", "vehicles.10.location[0]", lambda x: x + metres).apply(folder)

    return Damage("", change)


DAMAGES: list[tuple[type[Scene], Damage, str]] = [
    (OPV2VScene, removed("20/000072.yaml"), r"scenario/20: no file for frame 72, expected 000072\.yaml.*appear or dis"),
    (OPV2VScene, removed("*/000072.yaml"), r"scenario/6: frame 70 is followed by 74, expected 72"),
    (OPV2VScene, content("20/000069.yaml", b"{}"), "the ego has no frame 69"),
    (OPV2VScene, content("6/00068.yaml", b"{}"), r"found frame 68 twice, also 0+68\.yaml|000068"),
    (OPV2VScene, content("06/000068.yaml", b"{}")._replace(file=""), r"found agent 6 twice, also 06|06: found"),
    (OPV2VScene, without_folders("6", "9", "20"), "all 1 agents are"),
    (OPV2VScene, without_folders("6", "9", "20", "-3"), "found 0 scenarios"),
    (OPV2VScene, value(FILE, "lidar_pose", ["x"] * 6), r"lidar_pose\[0\]: found .*, expected `float`, got `str`"),
    (OPV2VScene, value(FILE, "lidar_pose", [1e300] * 6), r"lidar_pose\[0\]: found .*, expected `float` <= 100000000"),
    (OPV2VScene, value(FILE, "lidar_pose", [0.0] * 6), "lidar_pose is .* m from where"),
    (OPV2VScene, value("-3/000070.yaml", "lidar_pose", [0.0] * 6)._replace(file="-3"), ": the pole moves"),
    (OPV2VScene, value(FILE, "vehicles.9.extent", [0.0, 1.0, 1.0]), r"9\.extent\[0\]: .*, expected `float` > 0"),
    (OPV2VScene, value(FILE, "vehicles.9.extent", [1e6, 1.0, 1.0]), r"9\.extent\[0\]: .*, expected `float` <= 1000"),
    (OPV2VScene, value(FILE, "vehicles.9.angle", [True, 0.0, 0.0]), r"9\.angle\[0\]: .*, expected `float`, got `str`"),
    (OPV2VScene, value(FILE, "vehicles.x", 1), r"vehicles\.x: found 'x', expected `int`"),
    (OPV2VScene, moved(3.0, "000070.yaml", ("6",)), "object 10 is 3.00 m from where agent 6 lists it"),
    (OPV2VScene, moved(80.0, "000072.yaml"), r"000072\.yaml: object 10 is .* where it was in 000070\.yaml.*one object"),
    (OPV2VScene, value(FILE, "vehicles.9.location", [0.0] * 3), "object 9 is .* m from agent 9, .* the same car"),
    (MultiV2XScene, without_folders("map"), r"map: no files <frame>\.yaml, expected one with all"),
    (MultiV2XScene, removed("map/00070.yaml"), r"map: no file for frame 70"),
    (MultiV2XScene, removed("cav_6/00070_view.yaml"), r"cav_6: no file for frame 70, expected 000070_view\.yaml"),
    (MultiV2XScene, removed("cav_9/000070.yaml"), r"cav_9: no file for frame 70"),
    (MultiV2XScene, view((999, 1)), r"visible_objects\[0\]: found .*999.*, expected an object that the map has"),
    (MultiV2XScene, view((9, 1), (9, 1)), r"visible_objects\[1\]: found .*9.*, expected each object once"),
    (V2XRealScene, text("1/000000.yaml", "obj_type", "object_type"), "obj_type is missing"),
]


@pytest.fixture(scope="session")
def short_twins(original: Recording, tmp_path_factory: pytest.TempPathFactory) -> dict[type[Scene], Path]:
    """Twins of the first six frames."""
    short = replace(original, times_ns=original.times_ns[:6])
    folder = tmp_path_factory.mktemp("short")
    return {cls: write(short, folder / SHORT_NAMES[cls] / "scenario") for cls, write in WRITERS.items()}


@pytest.mark.parametrize(("cls", "damage", "message"), DAMAGES)
def test_a_damaged_scenario_is_refused_with_file_and_place(
    cls: type[Scene], damage: Damage, message: str, short_twins: Any, tmp_path: Path
) -> None:
    folder = Path(shutil.copytree(short_twins[cls], tmp_path / "scenario"))
    assert_refused(lambda path: read(cls, path), folder, damage, message)
