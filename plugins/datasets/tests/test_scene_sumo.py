"""Reading floating-car data of SUMO, and refusal of damaged ones."""

import gzip
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparison import assert_same, junction
from damages import Damage, assert_refused, content, text
from mast_datasets import SumoTrace
from reference_data import reference
from sumo_writer import write_sumo

from mast_zenoh.arrays.states import CLASSES
from mast_zenoh.errors import ConfigurationError, SceneError
from mast_zenoh.scenes import Recording
from mast_zenoh.sensing import CleanDetector


def vehicle(name: str, x: float, y: float = 0.0, angle: float = 90.0, kind: str = "car") -> str:
    return f'<vehicle id="{name}" x="{x:.2f}" y="{y:.2f}" angle="{angle:.2f}" type="{kind}" speed="10.00"/>'


def trace(steps: int = 5, *more: str) -> str:
    """A car that drives east at 10 m/s, a bus 20 m ahead, and a car 400 m away that goes north; 2 s to 2.4 s."""
    lines = ['<?xml version="1.0"?>', "<fcd-export>"]
    for k in range(steps):
        lines += [f'<timestep time="{2 + k / 10:.2f}">', vehicle("a", 100 + k), vehicle("b", 120 + k, kind="bus@b")]
        lines += [vehicle("c", 500, k, angle=0.0, kind="DEFAULT_VEHTYPE"), *more, "</timestep>"]
    return "\n".join([*lines, "</fcd-export>\n"])


TRACE = trace()
TYPES = '<routes>\n<vTypeDistribution id="d"><vType id="car" length="4" width="1.7"/></vTypeDistribution>\n</routes>\n'
TABLE = "t,id,class,x_front,y_front,heading_deg_cw_from_north,speed,length,width,height\n" + "".join(
    f"{2 + k / 10:.1f},{name},{kind},{x + k:.2f},0.00,90.0,10.00,{length},1.80,1.50\n"
    for k in range(5)
    for name, kind, x, length in (("a", "passenger", 100, "4.50"), ("b", "bus", 120, "12.00"))
)
HOUSES = (
    '<shapes>\n<poly id="1" type="building" shape="90,10 99,10 99,20 90,20"/>\n'
    '<poly id="2" type="water" shape="1,2"/>\n</shapes>\n'
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "fcd.xml").write_text(TRACE)
    (tmp_path / "types.rou.xml").write_text(TYPES)
    (tmp_path / "town.poly.xml").write_text(HOUSES)
    return tmp_path


def read(path: Path, **parameters: Any) -> Recording:
    return SumoTrace(path=str(path), **{"n_infrastructure": 0} | parameters).record(0, None)


@pytest.mark.parametrize("kind", ["xml", "csv"])
def test_a_twin_is_read_back(kind: str, tmp_path: Path) -> None:
    source = junction(n_infrastructure=0, n_mobile=2)
    path = write_sumo(source, tmp_path / "twin", kind)
    ego = f"user.{source.agents[0].object_id}"
    recording = read(path, ego=ego, n_mobile=12, radius_m=400.0, detector=CleanDetector())
    rows, columns = assert_same(recording, source, [*source.agent_position[0, 0, :2], 0.0], kept_ids=False)
    assert len(recording.buildings) == len(source.buildings)
    np.testing.assert_allclose(recording.building_height, source.building_height)
    np.testing.assert_array_equal(recording.points[rows][:, [*columns]], source.points[:, [*columns.values()]])


def test_the_box_is_behind_the_front_bumper_and_turned_from_north(folder: Path) -> None:
    recording = read(folder, ego="a", radius_m=500)
    truth = recording.truth_at(0)
    # The car: 4 m long, middle at 98. The bus: middle at 114. The other car heads north: its middle is 2.5 m south.
    np.testing.assert_allclose(truth.position[:, :2], [[0, 0], [16, 0], [402, -2.5]], atol=1e-9)
    np.testing.assert_allclose(truth.position[:, 2], truth.size[:, 2] / 2)
    np.testing.assert_allclose(truth.size, [[4.0, 1.7, 1.5], [12.0, 2.5, 3.4], [5.0, 1.8, 1.5]])
    np.testing.assert_allclose(truth.yaw, [0.0, 0.0, np.pi / 2])
    np.testing.assert_allclose(truth.velocity, [[10, 0, 0], [10, 0, 0], [0, 10, 0]], atol=1e-9)
    assert [CLASSES[k] for k in truth.class_id] == ["car", "bus", "car"]
    assert recording.times_ns.tolist() == [k * 100_000_000 for k in range(5)]
    np.testing.assert_allclose(recording.buildings[0], np.array([[90, 10], [99, 10], [99, 20], [90, 20]]) - [98, 0])
    assert recording.building_height.tolist() == [12.0]


def test_objects_far_from_the_route_of_the_ego_are_left_out_and_those_that_leave_vanish(folder: Path) -> None:
    assert np.diff(read(folder).truth_start).tolist() == [2] * 5
    text = TRACE
    for k in range(3, 5):
        text = text.replace(vehicle("b", 120 + k, kind="bus@b"), vehicle("b", 900, kind="bus@b"))
    (folder / "fcd.xml").write_text(text)
    assert np.diff(read(folder, ego="a").truth_start).tolist() == [2, 2, 2, 1, 1]
    with pytest.raises(ConfigurationError, match="n_mobile is 1, expected 0 to 0: 0 vehicles besides the ego have a"):
        read(folder, ego="a", n_mobile=1)


def test_the_window_is_chosen_by_start_and_duration(folder: Path) -> None:
    recording = read(folder, ego="a", start_s=2.1, duration_s=0.3)
    assert len(recording) == 3
    np.testing.assert_allclose(recording.truth_at(0).position[0], [0.0, 0.0, 0.75])
    assert len(read(folder, start_s=2.1)) == 4
    assert len(read(folder, duration_s=0.5)) == 5


def test_persons_are_where_the_trace_says(folder: Path) -> None:
    (folder / "fcd.xml").write_text(trace(5, '<person id="a" x="101" y="7" angle="180" speed="1"/>'))
    truth = read(folder, ego="a").truth_at(0)
    assert [CLASSES[k] for k in truth.class_id] == ["car", "bus", "pedestrian"]
    np.testing.assert_allclose(truth.position[2, :2], [3.0, 7.0])


def test_the_ground_is_at_the_height_of_the_trace_if_it_has_one(folder: Path) -> None:
    text = TRACE.replace('x="500', 'z="8" x="500')
    for x in ("10", "12"):
        text = text.replace(f'x="{x}', f'z="7.5" x="{x}')
    (folder / "fcd.xml").write_text(text)
    truth = read(folder, ego="a", radius_m=500).truth_at(0)
    np.testing.assert_allclose(truth.position[:, 2] - truth.size[:, 2] / 2, [0.0, 0.0, 0.5], atol=1e-9)


def test_tables_with_sizes_need_no_types_and_can_be_compressed(tmp_path: Path) -> None:
    (tmp_path / "fcd.csv.gz").write_bytes(gzip.compress(TABLE.encode()))
    truth = read(tmp_path / "fcd.csv.gz", ego="a").truth_at(0)
    np.testing.assert_allclose(truth.position[:, 0], [0.0, 120 - 6 - (100 - 2.25)])
    assert [CLASSES[k] for k in truth.class_id] == ["car", "bus"]


def test_the_default_ego_has_the_most_company_of_those_that_move(folder: Path) -> None:
    standing = "".join(vehicle(f"s{k}", 500 + 6 * k) for k in range(4))
    (folder / "fcd.xml").write_text(trace(5, standing))
    recording = read(folder)
    assert recording.agents[0].object_id == 3  # "c" moves among those that stand; names are numbered in order


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (content("fcd.xml", b"<fcd-export/>"), "found no time step, expected at least one"),
        (text("fcd.xml", '"2.10"', '"2.00"'), "line 8: <timestep>.time: found '2.00', expected a time later than"),
        (text("fcd.xml", '"2.40"', '"2.60"'), "frame 2.6 s: found a gap of 0.300 s after frame 2.3 s"),
        (
            text("fcd.xml", 'x="100.00"', ""),
            r"line 3: <timestep>.vehicle\[0\]: found .*, object missing required field `x`",
        ),
        (text("fcd.xml", 'x="100.00"', 'x="1e300"'), r"vehicle\[0\].x: found .*, expected `float` <= 1"),
        (text("fcd.xml", 'speed="10.00"', 'speed="900"'), r"vehicle\[0\].speed: found .*, expected `float` <= 200"),
        (
            text("fcd.xml", 'x="120.00"', 'x="120.00" z="1"'),
            r"line 3: <timestep>.vehicle\[1\]: found .*, expected z for all",
        ),
        (text("fcd.xml", 'id="b"', 'id="a"'), r"vehicle\[1\]: found .*, expected every id once at a time"),
        (text("fcd.xml", 'id="b"', 'id=""'), r"vehicle\[1\].id: found .*, expected `str` of length >= 1"),
        (text("fcd.xml", 'type="car"', 'type="cart"'), "type: found 'cart', expected a vehicle class, or the id of"),
        (text("types.rou.xml", 'length="4"', 'length="0"'), "line 2: <vType>.length: found '0', expected `float` > 0"),
        (text("types.rou.xml", "</vType", '<vType id="car"/></vType'), "line 2: <vType>: vType 'car' is already de"),
        (
            text("town.poly.xml", "90,10 99,10 99,20", "90,10"),
            "line 2: <poly>: found .*, expected 3 different corners or more, not 2",
        ),
        (
            text("town.poly.xml", "99,20", "99,20,3,4"),
            r"line 2: <poly>.shape\[2\]: found .*, expected `array` of length <= 3",
        ),
        (text("town.poly.xml", "shape=", 'geo="1" shape='), "line 2: <poly>: found geo coordinates"),
    ],
)
def test_damaged_files_are_refused_with_file_line_and_reason(folder: Path, damage: Damage, message: str) -> None:
    assert_refused(read, folder, damage, message)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (text("fcd.csv", "id,", "name,"), "line 1: found the columns t, name, .*, expected a time and an id"),
        (text("fcd.csv", "width", "length"), "line 1: found the columns .*length.*, expected each once"),
        (text("fcd.csv", ",1.50\n", "\n"), "line 2: found another number of fields, expected 10"),
        (text("fcd.csv", "100.00", ""), "line 2: found .*, object missing required field `x`"),
        (text("fcd.csv", ",height\n", ",z\n"), "line 2: found .*, expected a width and a height beside the length"),
        (text("fcd.csv", "12.00", "0"), "line 3.length: found .*, expected `float` > 0"),
        (text("fcd.csv", "2.1,a", '2.1,"a'), "not CSV: "),
    ],
)
def test_damaged_tables_are_refused_with_file_line_and_reason(damage: Damage, message: str, tmp_path: Path) -> None:
    (tmp_path / "fcd.csv").write_text(TABLE)
    assert_refused(read, tmp_path, damage, message)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        (dict(ego="z"), r"fcd\.xml: ego is 'z', expected the name of a vehicle in the trace from 2 to 2.4 s, such as"),
        (dict(start_s=1.0), r"fcd\.xml: start_s is 1, expected a time of the trace, 2 to 2.4"),
        (dict(start_s=7.0), r"fcd\.xml: start_s is 7, expected a time of the trace, 2 to 2.4"),
        (dict(duration_s=0.6), r"fcd\.xml: duration_s is 0.6, expected at most 0.5: the trace ends at 2.4"),
    ],
)
def test_windows_and_agents_that_are_not_there_are_refused(folder: Path, parameters: dict, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message):
        read(folder, **parameters)


def test_longitudes_and_latitudes_are_refused(folder: Path) -> None:
    text = TRACE
    for k in range(5):
        text = text.replace(f'x="{100 + k}.00"', f'x="{11.0 + k * 1.4e-5}"').replace(f'x="{120 + k}.00"', 'x="11.01"')
        text = text.replace(f'x="500.00" y="{k}.00"', f'x="11.02" y="{49.0 + k * 9e-6}"')
    (folder / "fcd.xml").write_text(text)
    with pytest.raises(SceneError, match=r"fcd\.xml: positions change by .* m where the speeds add up to 12.0 m"):
        read(folder)


def test_a_window_that_no_vehicle_spans_is_refused(folder: Path) -> None:
    (folder / "fcd.xml").write_text('<fcd-export><timestep time="0"/><timestep time="1"/></fcd-export>')
    with pytest.raises(SceneError, match=r"fcd\.xml: found no car, truck or bus with a box in all 2 frames"):
        read(folder)


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("name", "parameters", "buildings"),
    [
        ("sumo_veins_erlangen", dict(start_s=250.0, duration_s=3.0), True),
        ("sumo_bologna_pasubio", dict(start_s=300.0, duration_s=3.0), False),
    ],
)
def test_real_networks_are_read(name: str, parameters: dict, buildings: bool) -> None:
    recording = read(reference(name), n_infrastructure=2, n_mobile=3, detector=CleanDetector(), **parameters)
    assert len(recording) == 30
    assert recording.period_ns == 100_000_000
    assert bool(recording.buildings) == buildings
    assert 5 < len(recording.truth) / 30 < 200
    assert (recording.points >= 5).any(axis=0).all()
    moved = np.gradient(recording.agent_position[:, 0], 0.1, axis=0)
    # Positions are rounded to 1 cm, and speeds are those at the end of a step.
    assert np.median(np.linalg.norm(moved - recording.agent_velocity[:, 0], axis=1)) < 0.3


@pytest.mark.parametrize("ride", ["", ' vehicle="b"'])
def test_persons_in_a_vehicle_are_no_objects(folder: Path, ride: str) -> None:
    """SUMO gives them the place, angle and speed of their vehicle, and in some traces its id."""
    lines, walker = [], '<person id="walker" x="118.00" y="4.00" angle="90.00" speed="1.20" type="DEFAULT_PEDTYPE"/>'
    for line in TRACE.splitlines():
        seated = line.replace('id="b"', 'id="rider"').replace('type="bus@b"', f'type="DEFAULT_PEDTYPE"{ride}')
        lines += [line, seated.replace("<vehicle", "<person"), walker] if 'id="b"' in line else [line]
    (folder / "fcd.xml").write_text("\n".join(lines))
    (folder / "types.rou.xml").write_text(TYPES.replace("</routes>", '<vType id="bus" vClass="bus"/></routes>'))
    scene = read(folder, ego="a")
    kinds = [CLASSES[index] for index in scene.truth_at(0).class_id]
    assert sorted(kinds) == ["bus", "car", "pedestrian"]
