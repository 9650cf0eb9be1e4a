"""Reading the CARLA multi-agent layout, and refusal of damaged scenes."""

import json
import shutil
import tarfile
from pathlib import Path

import numpy as np
import pytest
from carla_writer import FRAMES, actors_at, npcs_at, state, write_lines, write_objects, write_run
from comparison import lidar_pose
from damages import Damage, assert_refused, content, removed, text
from mast_datasets import AVstackScene
from mast_datasets.avstack import EGO_ID

from mast_zenoh import scenario
from mast_zenoh.arrays.geometry import wrap_angle
from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import Recording
from mast_zenoh.sensing import CleanDetector, LidarSensor, Walls, lidar_points, to_world


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return write_run(tmp_path / "town" / "run-0")


def read(path: Path, **parameters: object) -> Recording:
    return AVstackScene(path=str(path), **parameters).record(0, None)


BOX = {"x": 10.0, "y": 3.0, "z": -1.0, "l": 4.0, "w": 2.0, "h": 1.5}


def nothing(key: str) -> list[dict]:
    return [{"frame": frame, "agent": agent, key: []} for frame in FRAMES for agent in (0, 1)]


def test_truth_is_in_the_world_frame_and_includes_the_ego(run: Path) -> None:
    recording = read(run)
    truth = recording.truth_at(0)
    assert truth.id.tolist() == [0, 1, EGO_ID]
    assert [CLASSES[k] for k in truth.class_id] == ["car", "truck", "car"]
    np.testing.assert_allclose(truth.position, [[10.4, 3.8, 0.75], [20.0, -3.6, 1.5], [0.4, 0.0, 0.75]])
    np.testing.assert_allclose(truth.size[:2], [[4.2, 1.8, 1.5], [8.0, 2.5, 3.0]])
    np.testing.assert_allclose(truth.yaw, [np.pi / 2, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(truth.velocity[0], [0.0, 2.0, 0.0])
    assert recording.times_ns.tolist() == [400_000_000, 500_000_000, 600_000_000, 700_000_000]


def test_agents_have_names_poses_and_mounts(run: Path) -> None:
    recording = read(run)
    ego, pole = recording.agents
    assert (ego.name, ego.kind, ego.object_id) == ("ego", "mobile", EGO_ID)
    assert (pole.name, pole.kind, pole.object_id) == ("infra_1", "static", -1)
    np.testing.assert_allclose(ego.sensor.mount_position, [0.0, 0.0, 1.8], atol=1e-9)
    np.testing.assert_allclose(recording.agent_velocity[1, 0], [1.0, 0.0, 0.0])
    # The pole looks against x, 30 degrees down.
    forward = recording.agent_rotation[0, 1] @ pole.sensor.mount_rotation @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(forward, [-np.cos(np.radians(30)), 0.0, -0.5], atol=1e-9)


def test_a_camera_is_read_from_its_calibration(run: Path) -> None:
    recording = read(run)
    ahead = recording.agent_position[0, 0] + [20.0, 0.0, 1.8]
    pixels, depth = recording.agents[0].camera.project(
        ahead[None], recording.agent_position[0, 0], recording.agent_rotation[0, 0]
    )
    np.testing.assert_allclose(pixels, [[400.0, 300.0]], atol=1e-6)
    np.testing.assert_allclose(depth, [20.0])


def test_objects_listed_by_a_lidar_have_returns_by_visible_fraction_and_others_none(run: Path) -> None:
    recording = read(run)
    points = recording.points_at(0)
    position, rotation = recording.agent_position[0, 1], recording.agent_rotation[0, 1]
    truth = recording.truth_at(0)
    cast = lidar_points(LidarSensor.infrastructure(), position, rotation, truth.position, truth.size, truth.yaw)
    assert points[0, 1] == round(0.5 * cast[0]) >= 5
    assert points[1, 1] == 0
    assert (points[:2, 0] >= 5).all()
    # No file lists the agents: ray casting decides whether the pole sees the ego.
    assert points[2].tolist() == [0, cast[2]]

    # Completely occluded objects are not seen; without files, rays are cast.
    hidden = npcs_at(4)
    hidden[0] |= {"occlusion": 3}
    hidden[1] |= {"occlusion": 0, "visible_fraction": 0.0}
    write_objects(run / "objects_sensor" / "lidar-0-0", "objects", 4, hidden)
    assert read(run).points_at(0)[:2, 0].tolist() == [0, 0]
    shutil.rmtree(run / "objects_sensor" / "lidar-0-0")
    assert (read(run).points_at(0)[:2, 0] > 100).all()


def test_missing_velocities_are_computed_from_positions(run: Path) -> None:
    for frame in FRAMES:
        states = npcs_at(frame)
        states[0]["velocity"] = None
        write_objects(run / "objects", "npcs", frame, states)
    np.testing.assert_allclose(read(run).truth_at(1).velocity[0], [0.0, 2.0, 0.0], atol=1e-9)


def test_the_run_is_found_from_the_folder_above_and_in_an_archive(run: Path, tmp_path: Path) -> None:
    expected = read(run)
    with tarfile.open(tmp_path / "town.tar.gz", "w:gz") as archive:
        archive.add(run.parent, "town")
    for path in (run.parent, tmp_path / "town.tar.gz", run.parent.parent):
        np.testing.assert_array_equal(read(path).truth.position, expected.truth.position)


def test_detections_next_to_the_scene_are_replayed(run: Path) -> None:
    lines = nothing("detections")
    detection = BOX | {"yaw": 1.5, "score": 0.75, "class": "car"}
    lines[0]["detections"] = [detection | {"gt": 0}, detection | {"covariance": np.eye(3).tolist()}]
    lines[2]["detections"] = [BOX | {"q": [np.cos(0.2), 0.0, 0.0, -np.sin(0.2)]}]
    write_lines(run.parent / "detections.jsonl", lines)
    recording = read(run)
    detections = recording.detections_at(0, 0)
    np.testing.assert_allclose(detections.position, [[10.0, 3.0, -1.0]] * 2)
    np.testing.assert_allclose(detections.size[0], [4.0, 2.0, 1.5])
    assert recording.detection_truth_id_at(0, 0).tolist() == [0, -1]
    assert detections.covariance[:, 0, 0].tolist() == [0.0, 1.0]
    np.testing.assert_allclose(recording.detections_at(1, 0).yaw, [0.4])
    assert len(recording.detections) == 3
    assert len(read(run, replay=False, detector=CleanDetector()).detections_at(0, 0)) == 2


def test_visibility_and_building_files_next_to_the_scene_are_used(run: Path) -> None:
    lines = nothing("objects")
    lines[1]["objects"] = [[0, 17, 20, 0.85], [EGO_ID, 3]]
    write_lines(run.parent / "visibility.jsonl", lines)
    (run.parent / "buildings.json").write_text("[[[50, 50], [60, 50], [60, 60], [50, 50]]]")
    (run.parent / "scene.json").write_text('{"building_height_m": 9}')
    recording = read(run)
    assert recording.points_at(0).tolist() == [[0, 17], [0, 0], [0, 3]]
    assert recording.buildings[0].tolist() == [[50, 50], [60, 50], [60, 60]]
    assert recording.building_height.tolist() == [9.0]


def played(*settings: str) -> dict[str, NodeSpec]:
    """The nodes of the baseline with these settings."""
    return scenario.resolve(*scenario.load("baseline", settings)).nodes


def test_all_agents_of_a_scene_with_two_cars_are_used_by_default(tmp_path: Path) -> None:
    run = write_run(tmp_path / "run-0", second_car=True)
    assert read(run).agent_names == ("ego", "mobile_2", "infra_1")
    assert read(run, n_mobile=0).agent_names == ("ego", "infra_1")
    nodes = played(f"scene=avstack:{run}")
    assert [name for name, spec in nodes.items() if spec.role == "agent"] == ["ego", "mobile_2", "infra_1"]
    with pytest.raises(ConfigurationError, match="n_infrastructure is 9, expected 0 to 1"):
        played(f"scene=avstack:{run}", "n_infrastructure=9", "n_mobile=1")
    with pytest.raises(ConfigurationError, match="n_mobile is 3, expected 0 to 1"):
        played(f"scene=avstack:{run}", "n_infrastructure=1", "n_mobile=3")


def test_scenarios_that_name_agents_match_those_of_the_data_set(tmp_path: Path) -> None:
    scene = f"scene=avstack:{write_run(tmp_path / 'run-0', second_car=True)}"
    _, passthrough = scenario.load("passthrough", [scene])
    agents = [adversary["agent"] for adversary in passthrough["adversaries"].values()]
    assert agents == ["ego", "mobile_2", "infra_1"]
    _, partition = scenario.load("attack_during_partition", [scene])
    assert partition["faults"][0]["nodes"] == ["mobile_2", "infra_1"]
    _, chaos = scenario.load("chaos", [scene])
    assert chaos["scene"] == dict(type="AVstackScene", path=str(tmp_path / "run-0"))
    with pytest.raises(SceneError, match=r"passthrough\.py: .*/nowhere: no such file"):
        scenario.load("passthrough", [f"scene=avstack:{tmp_path}/nowhere"])


ACTORS, NPCS = (f"objects/objectstate-{kind}-0000000005-000000000.50.txt" for kind in ("actors", "npcs"))
CALIBRATION = "data/lidar-0-0/calib-timestamp_00000.50-frame_000005.txt"


def npcs(*states: dict, time: float | None = None) -> Damage:
    """Other objects in frame 5."""
    return Damage("-npcs-", lambda run: write_objects(run / "objects", "npcs", 5, [*states], time=time))


def actors(*states: dict) -> Damage:
    return Damage("-actors-", lambda run: write_objects(run / "objects", "actors", 5, [*states]))


def without_ego(run: Path) -> None:
    for frame in FRAMES:
        write_objects(run / "objects", "actors", frame, actors_at(frame)[1:])


def at_time_of_frame_before(run: Path) -> None:
    write_objects(run / "objects", "actors", 5, actors_at(5), time=0.4)
    write_objects(run / "objects", "npcs", 5, npcs_at(5), time=0.4)


TURNED = json.loads(json.dumps(npcs_at(5)[1]).replace("1.0", "2.0"))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (content(ACTORS, b'{"datacontainer"'), "not JSON: Input data was truncated"),
        (removed(NPCS), r"objectstate-npcs-0000000005-000000000\.50\.txt: .*No such file"),
        (removed("objects/*-0000000006-*"), "objects: frame 5 is followed by 7, expected 6"),
        (removed("objects_sensor/lidar-0-1/*-0000000006-*"), "lidar-0-1: no objects file for frame 6"),
        (Damage("", lambda run: shutil.rmtree(run / "data/lidar-0-0")), "data: no folder lidar-<k>-0 for agent 0"),
        (text(CALIBRATION, "1.8]", "5.8]"), r"the lidar is at \[0\.5, 0\.0, 5\.8\], expected \[0\.5, 0\.0, 1\.8\]"),
        (text(NPCS, "20.0", "NaN", 9), r"data\[1\]\.objectstate\.position: not JSON"),
        (text(NPCS, "20.0", "1e999", 9), r"data\[1\]\.objectstate\.position: not JSON: Number out of range"),
        (text(NPCS, "attitude", "altitude", 99), r"data\[0\]\.objectstate: attitude is missing"),
        (npcs(npcs_at(5)[0], TURNED), r"data\[1\]\..*expected a quaternion qw, qv of length 1"),
        (npcs(state("car", 4, [0.0, 0.0, 0.0], where="top")), r"data\[0\]\..*where_is_t: found 'top', expected one of"),
        (npcs(state("car", 4, [0.0, 0.0, 0.0], hwl=[0.0, 1.0, 1.0])), r"data\[0\]\..*hwl\[0\]: found .*, expected"),
        (npcs(npcs_at(5)[0], npcs_at(5)[0]), "two objects have the same ID"),
        (text(ACTORS, '"frame": 5', '"frame": 9'), "frame: found 9, expected 5 as in the name"),
        (Damage("-actors-", at_time_of_frame_before), r"time 0\.4 s is not later than 0\.4 s"),
        (npcs(*npcs_at(5), time=0.55), r"time 0\.55 s, but 0\.5 s in"),
        (actors(*actors_at(5)[:1]), r"actors \[0\], but \[0, 1\] in the first frame"),
        (Damage("", without_ego), "no actor has a box"),
        (content("objects/objectstate-actors-5.txt", b""), "found no frame number in the name"),
        (
            Damage("", lambda run: (run / "objects").rename(run / "things")),
            "run-0: found 0 run folders, which have objects/",
        ),
    ],
)
def test_a_damaged_scene_is_refused_with_file_and_reason(run: Path, damage: Damage, message: str) -> None:
    assert_refused(read, run, damage, message)


def test_files_that_are_not_scenes_are_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "scene.tar.gz"
    for damage in (Damage("scene.tar.gz", str), content(path.name, b""), content(path.name, b"not an archive")):
        assert_refused(lambda folder: read(folder / path.name), tmp_path, damage, "")


@pytest.mark.parametrize(
    ("file", "entry", "reason"),
    [
        ("detections", {"detections": [{"x": 1.0}]}, "line 1: 'y' is missing"),
        ("detections", {"detections": None}, "line 1: detections is not a list"),
        ("detections", {"detections": [{"x": float("nan")}]}, "line 1: NaN is not a finite"),
        ("detections", {"detections": [BOX | {"h": 0.0, "yaw": 0.0}]}, "line 1: l, w, h: found 0"),
        ("detections", {"agent": 1}, "line 2: frame 4 of agent 1 is already in line 1"),
        ("detections", {"frame": 9}, "no line for frame 4, agent 0"),
        ("visibility", {"objects": [[77, 5]]}, "line 1: object 77 is not in the scene"),
    ],
)
def test_damaged_lines_are_refused_with_their_number(run: Path, file: str, entry: dict, reason: str) -> None:
    first, *others = nothing("objects" if file == "visibility" else file)
    write_lines(run / f"{file}.jsonl", [first | entry, *others])
    with pytest.raises(SceneError, match=rf"{file}\.jsonl: {reason}"):
        read(run)


def test_damaged_buildings_are_refused(run: Path) -> None:
    for outline in ("[[[0, 0], [1, 1]]]", "[[[0, 0], [1, 0], [1, null]]]", "{", "3"):
        assert_refused(read, run, content("buildings.json", outline.encode()), ": ")


def test_the_test_scene_of_the_original_reader_is_readable(carla_fixture: Path) -> None:
    recording = read(carla_fixture)
    assert recording.agent_names == ("ego", "infra_1")
    assert recording.times_ns.tolist() == [400_000_000, 500_000_000, 600_000_000]
    assert recording.truth_at(0).id.tolist() == [0, 1, EGO_ID]
    np.testing.assert_allclose(recording.truth_at(0).position[1, :2], [20.0, -3.6])
    assert (recording.points_at(0)[:2] >= 5).all()
    assert np.isfinite(recording.detections.position).all()


def test_scene_a_is_read_as_listed_in_its_own_tables(scene_a: Path) -> None:
    recording = read(scene_a)
    assert recording.agent_names == ("ego", "infra_1", "infra_2", "infra_3", "infra_4")
    assert len(recording) == 150
    tables = json.loads((scene_a / "truth.json").read_text())
    for frame in range(150):
        truth = recording.truth_at(frame)
        rows = {row[0]: row for row in tables[str(frame + 1)]}
        assert truth.id.tolist() == sorted(rows)
        table = np.array([rows[number][1:8] for number in truth.id])
        np.testing.assert_allclose(truth.position, table[:, :3], atol=1e-9)
        np.testing.assert_allclose(truth.size, table[:, 5:2:-1], atol=1e-9)
        np.testing.assert_allclose(wrap_angle(truth.yaw - table[:, 6]), 0.0, atol=1e-9)
        seen = [[agent for agent in range(5) if points[agent] >= 5] for points in recording.points_at(frame)]
        assert seen == [rows[number][8] for number in truth.id]


def test_detections_of_scene_a_match_their_objects(scene_a: Path) -> None:
    recording = read(scene_a)
    errors = []
    for frame in range(0, 150, 5):
        truth = recording.truth_at(frame)
        for a in range(len(recording.agents)):
            pose = lidar_pose(recording, frame, a)
            ids = recording.detection_truth_id_at(frame, a)
            detections = to_world(recording.detections_at(frame, a), *pose).select(ids >= 0)
            rows = np.searchsorted(truth.id, ids[ids >= 0])
            turned = wrap_angle(detections.yaw - truth.yaw[rows])
            errors.append(np.column_stack([detections.position - truth.position[rows], turned]))
    # Its README: 0.3 m in x and y, 0.1 m in z, 3 degrees.
    spread = np.concatenate(errors).std(axis=0)
    np.testing.assert_allclose(spread, [0.3, 0.3, 0.1, np.radians(3)], rtol=0.1)


def test_ray_casting_reproduces_the_returns_listed_in_scene_a(scene_a: Path) -> None:
    recording = read(scene_a)
    walls = Walls.of_buildings(recording.buildings, recording.building_height)
    # Its ego's first beam points at -180 degrees; here, beams are in the middle of their steps.
    roof = LidarSensor(azimuth_min_deg=-180.1, azimuth_max_deg=179.9)
    for frame in range(0, 150, 10):
        truth = recording.truth_at(frame)
        for a, agent in enumerate(recording.agents):
            shapes = truth.position, truth.size, truth.yaw
            own = int(np.flatnonzero(np.append(truth.id, agent.object_id) == agent.object_id)[0])
            own = own if own < len(truth) else -1
            cast = lidar_points(agent.sensor if a else roof, *lidar_pose(recording, frame, a), *shapes, walls, own)
            np.testing.assert_allclose(cast, recording.points_at(frame)[:, a], atol=1)
