"""Reading CommonRoad scenarios, and refusal of damaged ones."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commonroad_writer import write_commonroad
from comparison import assert_same, flat_junction
from mast_datasets import CommonRoadScenario
from reference_data import reference

from mast_zenoh.arrays.states import CLASS_INDEX
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import Recording
from mast_zenoh.sensing import CleanDetector

STATE = """<{tag}><position><point><x>{x}</x><y>1</y></point></position><orientation><exact>0.0</exact></orientation>
<time><exact>{step}</exact></time><velocity><exact>10</exact></velocity></{tag}>
"""


def car(number: int, x: float, steps: range, shape: str = "", kind: str = "car") -> str:
    """A car that drives east at 10 m/s."""
    shape = shape or "<rectangle><length>4</length><width>2</width></rectangle>"
    states = [STATE.format(tag="state", x=x + k, step=k) for k in steps]
    states[0] = states[0].replace("<state>", "<initialState>").replace("</state>", "</initialState>")
    return (
        f'<dynamicObstacle id="{number}"><type>{kind}</type><shape>{shape}</shape>'
        f"{states[0]}<trajectory>{''.join(states[1:])}</trajectory></dynamicObstacle>\n"
    )


def scenario(*obstacles: str) -> str:
    root = '<commonRoad commonRoadVersion="2020a" timeStepSize="0.1" benchmarkID="ROAD">\n'
    return f'<?xml version="1.0"?>\n{root}{"".join(obstacles)}</commonRoad>\n'


ROAD = scenario(car(1, 0.0, range(5)), car(2, 20.0, range(5)), car(3, 30.0, range(3)))


def read(path: Path, text: str | bytes | None = None, **parameters: Any) -> Recording:
    if text is not None:
        path.write_bytes(text.encode() if isinstance(text, str) else text)
    return CommonRoadScenario(path=str(path), **{"n_infrastructure": 0} | parameters).record(0, None)


@pytest.mark.parametrize("version", ["2020a", "2018b"])
def test_a_twin_is_read_back(version: str, tmp_path: Path) -> None:
    source = flat_junction()
    path = write_commonroad(source, tmp_path / "twin.xml", version)
    recording = read(path, ego=source.agents[0].object_id, n_mobile=12, detector=CleanDetector())
    assert recording.truth.id.tolist() == source.truth.id.tolist()
    assert recording.agents[0].object_id == source.agents[0].object_id
    rows, columns = assert_same(recording, source, [*source.agent_position[0, 0, :2], 0.0])
    np.testing.assert_allclose(recording.truth.velocity, source.truth.velocity, atol=1e-9)
    if version == "2020a":  # the older version has no buildings
        np.testing.assert_array_equal(recording.points[rows][:, [*columns]], source.points[:, [*columns.values()]])
        assert len(recording.buildings) == len(source.buildings)


def test_the_frames_are_those_of_the_ego_and_the_origin_is_below_it(tmp_path: Path) -> None:
    recording = read(tmp_path / "road.xml", ROAD, ego=3)
    assert len(recording) == 3
    assert recording.name == "ROAD"
    assert recording.times_ns.tolist() == [0, 100_000_000, 200_000_000]
    np.testing.assert_allclose(recording.truth_at(0).position, [[-30, 0, 0.75], [-10, 0, 0.75], [0, 0, 0.75]])
    np.testing.assert_allclose(recording.truth.velocity, [[10.0, 0.0, 0.0]] * 9)
    np.testing.assert_allclose(recording.truth_at(0).size, [[4.0, 2.0, 1.5]] * 3)


def test_the_ego_is_the_vehicle_with_the_most_company_of_those_there_longest(tmp_path: Path) -> None:
    far = car(4, 500.0, range(5))
    recording = read(tmp_path / "road.xml", scenario(far, car(1, 0.0, range(5)), car(2, 20.0, range(5))), n_mobile=2)
    assert [agent.object_id for agent in recording.agents] == [1, 2, 4]
    with pytest.raises(ConfigurationError, match="ego is 12, expected the id of a dynamic vehicle: 1, 2, 4"):
        read(tmp_path / "road.xml", ego=12)


def test_objects_that_leave_are_there_until_they_do_with_velocities_of_their_positions(tmp_path: Path) -> None:
    recording = read(tmp_path / "road.xml", ROAD.replace("<velocity><exact>10</exact></velocity>", ""), ego=1)
    assert np.diff(recording.truth_start).tolist() == [3, 3, 3, 2, 2]
    np.testing.assert_allclose(recording.truth.velocity[:, 0], 10.0)


CORNERS = ((0, 0), (4, 0), (4, 2), (0, 2), (0, 0))  # closed by its first corner
POLYGON = "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in CORNERS)
TURNED = "<length>4</length><width>2</width><orientation>0.5</orientation><center><x>1</x><y>-0.5</y></center>"


@pytest.mark.parametrize(
    ("shape", "size", "middle", "yaw"),
    [
        ("<circle><radius>0.5</radius></circle>", [1.0, 1.0], [0.0, 0.0], 0.0),
        (f"<rectangle>{TURNED}</rectangle>", [4.0, 2.0], [1.0, -0.5], 0.5),
        (f"<polygon>{POLYGON}</polygon>", [4.0, 2.0], [2.0, 1.0], 0.0),
    ],
)
def test_other_shapes_become_the_box_around_them(
    shape: str, size: list[float], middle: list[float], yaw: float, tmp_path: Path
) -> None:
    text = scenario(car(1, 0.0, range(5)), car(2, 10.0, range(5), shape, "pedestrian"))
    truth = read(tmp_path / "road.xml", text).truth_at(0)
    np.testing.assert_allclose(truth.position[1], [10 + middle[0], middle[1], 1.719 / 2])
    np.testing.assert_allclose([*truth.size[1, :2], truth.yaw[1]], [*size, yaw])
    assert truth.class_id.tolist() == [CLASS_INDEX["car"], CLASS_INDEX["pedestrian"]]


def test_static_obstacles_stand_still_and_only_road_users_are_objects(tmp_path: Path) -> None:
    def static(number: int, kind: str) -> str:
        text = car(number, 8.0, range(1)).replace("dynamicObstacle", "staticObstacle")
        return text.replace("<trajectory></trajectory>", "").replace("<type>car", f"<type>{kind}")

    others = static(7, "parkedVehicle"), static(8, "roadBoundary"), '<phantomObstacle id="9"/>'
    recording = read(tmp_path / "road.xml", scenario(car(1, 0.0, range(5)), *others))
    assert recording.truth.id.tolist() == [1, 7] * 5
    parked = recording.truth.position[recording.truth.id == 7]
    np.testing.assert_allclose(parked, [[8.0, 0.0, 0.75]] * 5)
    np.testing.assert_allclose(recording.truth.velocity[recording.truth.id == 7], 0.0)


def test_compressed_scenarios_and_folders_with_a_single_one_are_read(tmp_path: Path) -> None:
    plain = read(tmp_path / "road.xml", ROAD)
    (tmp_path / "zipped").mkdir()
    zipped = read(tmp_path / "zipped" / "road.xml.gz", gzip.compress(ROAD.encode()))
    np.testing.assert_array_equal(plain.truth.position, zipped.truth.position)
    assert len(read(tmp_path / "zipped")) == len(plain)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"2020a"', '"2030x"', "line 2: <commonRoad>.commonRoadVersion: found '2030x', expected one of 2018b"),
        ('"0.1"', '"0"', "line 2: <commonRoad>.timeStepSize: found '0', expected `float` >= 0.001"),
        ('id="2"', 'id="1"', "line 14: <dynamicObstacle>: id 1 occurs twice"),
        (
            "<type>car",
            "<type>spaceship",
            "line 3: <dynamicObstacle>.type: found 'spaceship', expected one of car, taxi",
        ),
        ("<length>4", "<length>0", "<dynamicObstacle>.shape.rectangle.length: found '0', expected `float` > 0"),
        ("<width>2", "<width>-2", "shape.rectangle.width: found '-2', expected `float` > 0"),
        ("<rectangle>", "<rectangle/><rectangle>", "shape.rectangle: found .*, expected an object"),
        ("<x>0.0", "<x>1e99", "line 3: <dynamicObstacle>.*x: found '1e99', expected `float` <="),
        ("<time><exact>2", "<time><exact>3", "time.exact: found '3', expected 2, the next time step"),
        ("trajectory>", "occupancySet>", "expected a trajectory, not an occupancySet"),
        ("<type>car", "<type>pedestrian", "found no dynamic car, truck or bus, expected one for the ego"),
    ],
)
def test_a_damaged_scenario_is_refused_with_file_line_and_reason(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    assert old in ROAD
    count = 9 if "pedestrian" in new else 2 if "occupancySet" in new else 1
    with pytest.raises(SceneError, match=rf"road\.xml: .*{message}"):
        read(tmp_path / "road.xml", ROAD.replace(old, new, count))


@pytest.mark.heavy
def test_real_scenarios_are_read_and_their_vehicles_move_as_stated() -> None:
    files = sorted(reference("commonroad_ngsim").glob("*.xml"))
    frames = {}
    for path in files:
        recording = read(path, n_infrastructure=2, n_mobile=2, detector=CleanDetector())
        frames[path.name] = len(recording)
        assert recording.period_ns == 100_000_000
        seen = (recording.points >= 5).mean(axis=0)
        assert (seen > 0.3).all()
        assert np.linalg.norm(recording.truth.velocity, axis=1).max() < 25
        # What the file states as velocity is how the positions change.
        ego = recording.agent_position[:, 0]
        moved = np.gradient(ego, 0.1, axis=0)
        assert np.median(np.linalg.norm(moved - recording.agent_velocity[:, 0], axis=1)) < 0.5
    assert frames == {
        "USA_Lanker-1_1_T-1.xml": 41,
        "USA_Peach-4_8_T-1.xml": 61,
        "USA_US101-3_3_T-1.xml": 32,
        "USA_US101-4_1_T-1.xml": 101,
    }
