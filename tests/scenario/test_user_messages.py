"""A node's own message type is sent, recorded, measured and compared like a built-in type."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from launched_apart import Beside

import mast_zenoh as mast
from mast_zenoh import scenario, testing
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import ConfigurationError, MastError, WiringError
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.file_server import files_for_node
from mast_zenoh.messages import user_types
from mast_zenoh.run_folder.recording import difference
from mast_zenoh.run_folder.recording.difference import explain

FRAMES = 4
TYPES = """
from mast_zenoh.messages import Column, Schema

WIND = Schema("wind", 1, "what weather stations measure", (
    Column("station", "str", ("n",), "", "its name"),
    Column("position", "float64", ("n", 3), "m", "where it stands"),
    Column("velocity", "float64", ("n", 3), "m/s", "of the air"),
    Column("origin", "float64", (2,), "", "no frame of reference"),
))
"""
STATION = """
import numpy as np

from mast_zenoh.messages import text
from mast_zenoh.node import Node
from weather_types import WIND


class Station(Node):
    role = "station"
    inputs = {"clock": "clock"}
    outputs = {"wind": WIND}

    def __init__(self, strength: float = 1.0):
        self.strength = strength

    def on_clock(self, received, context):
        velocity = self.strength * context.rng("wind", received.frame).normal(size=(2, 3))
        columns = {"station": text(["east", "west"]), "position": np.eye(3)[:2], "velocity": velocity}
        context.publish("wind", columns | {"origin": np.zeros(2)})
"""
LISTENER = """
from mast_zenoh.node import Node
from weather_types import WIND


class Listener(Node):
    role = "listener"
    inputs = {"wind": WIND}

    def __init__(self):
        self.rows = 0

    def on_wind(self, received, context):
        self.rows += len(received.body["station"])

    def finish(self, context):
        return {"rows": self.rows}
"""
MOVER = """
from mast_zenoh.node import Node
from weather_types import WIND


class Mover(Node):
    role = "mover"
    inputs = {"wind": WIND}
    outputs = {"wind_out": "wind"}

    def on_wind(self, received, context):
        context.relay("wind_out", received, dict(received.body) | {"position": received.body["position"] + 1.0})
"""
SCENARIO = """
from mast_zenoh.scenario import load


def scenario(strength=1.0, moved=False):
    _, base = load("baseline", ["n_infrastructure=1"])
    wind = dict(key="wind", message="wind", **{"from": "station.wind", "to": ["listener.wind"]})
    rewrite = dict(wire=[wind], listen=[dict(wire="clock", role="station", input="clock")])
    nodes = dict(station=dict(role="station", strength=strength), listener=dict(role="listener"))
    if moved:
        nodes["mover"] = dict(role="mover")
        rewrite["insert"] = [dict(wire="wind", role="mover", input="wind", output="wind_out")]
    return base | dict(nodes=nodes, keyexpr=dict(map="testbed.toml", rewrites=[rewrite]))
"""
FILES = {
    "weather_types.py": TYPES,
    "station.py": STATION,
    "listener.py": LISTENER,
    "mover.py": MOVER,
    "windy.py": SCENARIO,
}


@pytest.fixture(autouse=True)
def ours_alone_afterwards() -> Iterator[None]:
    yield
    user_types.use(())


@pytest.fixture
def windy(tmp_path: Path) -> Path:
    """A scenario whose nodes import a message type from a file next to them."""
    return written(tmp_path)


def written(folder: Path, **changed: str) -> Path:
    for name, content in FILES.items():
        (folder / name).write_text(changed.get(name.removesuffix(".py"), content))
    return folder / "windy.py"


def resolved(file: Path, **parameters: Any) -> Resolved:
    path, content = scenario.load_values(file, parameters)
    return scenario.resolve(path, content, frames=FRAMES, seed=3, record=True)


def play(file: Path, out: Path, **parameters: Any) -> mast.Run:
    return mast.run(file, frames=FRAMES, seed=3, out=out, **parameters)


def test_messages_of_a_users_type_are_recorded_and_read(windy: Path, tmp_path: Path) -> None:
    run = play(windy, tmp_path / "run")
    assert json.loads((run.path / "results" / "listener" / "results.json").read_text()) == {"rows": 2 * FRAMES}
    user_types.use(())  # another process, which has not loaded the scenario
    messages = list(run.messages("wind"))
    assert [message.frame for message in messages] == list(range(FRAMES))
    assert repr(messages[0]).startswith("<wind on wind, frame 0, from station: station (2,), position (2, 3), ")
    for message in messages:
        assert message.type == "wind"
        assert message["station"].tolist() == ["east", "west"]
        assert message["velocity"].shape == (2, 3)
    assert len({message["velocity"].tobytes() for message in messages}) == FRAMES


def test_two_runs_are_compared_column_by_column(windy: Path, tmp_path: Path) -> None:
    a, b, c = (play(windy, tmp_path / name, strength=strength) for name, strength in dict(a=1.0, b=1.0, c=2.0).items())
    user_types.use(())
    assert difference.compare(a.path, b.path).first is None
    found = difference.compare(a.path, c.path)
    assert found.differing == {"wind": FRAMES}
    text = "\n".join(explain(found))
    assert "difference: frame 0" in text
    assert "velocity row 0[0]: A " in text
    assert " m/s" in text


def test_a_type_that_was_changed_between_two_runs_is_named(tmp_path: Path) -> None:
    runs = []
    for name, version, unit in (("a", "1", "m/s"), ("b", "2", "km/h")):
        (tmp_path / name).mkdir()
        changed = TYPES.replace('"wind", 1', f'"wind", {version}').replace("m/s", unit)
        changed = changed.replace("(2,)", f"({int(version) + 1},)")
        station = STATION.replace("np.zeros(2)", f"np.zeros({int(version) + 1})")
        runs.append(play(written(tmp_path / name, weather_types=changed, station=station), tmp_path / f"run {name}"))
    assert [next(run.messages("wind"))["origin"].shape for run in runs] == [(2,), (3,)], "each by its own type"
    text = "\n".join(explain(difference.compare(runs[0].path, runs[1].path)))
    assert "type 'wind' differs" in text
    assert "origin float64 (3))" in text
    assert "station row" not in text, "what is the same in both is compared, and equal"


def test_changes_by_an_interposer_are_measured(windy: Path, tmp_path: Path) -> None:
    run = play(windy, tmp_path / "run", moved=True)
    effects = [row for row in run.attacks.to_pylist() if row["interposer"] == "mover"]
    assert {(row["effect"], row["wire"]) for row in effects} >= {("moved", "wind")}
    moved = [row for row in effects if row["effect"] == "moved"]
    assert {round(row["after_z"] - row["before_z"], 9) for row in moved} == {1.0}


def test_a_type_with_different_columns_has_no_objects_to_measure(tmp_path: Path) -> None:
    flat = TYPES.replace('"float64", ("n", 3), "m"', '"float64", ("n", 2), "m"')
    file = written(tmp_path, weather_types=flat, station=STATION.replace("np.eye(3)[:2]", "np.eye(2)"))
    run = play(file, tmp_path / "run", moved=True)
    effects = {row["effect"] for row in run.attacks.to_pylist() if row["interposer"] == "mover"}
    assert effects
    assert "moved" not in effects


def test_messages_are_the_same_in_every_order_of_delivery(windy: Path) -> None:
    testing.check_scenario(windy, frames=FRAMES, moved=True)


def test_two_runs_with_different_types_do_not_affect_each_other(tmp_path: Path) -> None:
    prepared = []
    for name, size in (("a", 2), ("b", 3)):
        (tmp_path / name).mkdir()
        types, station = TYPES.replace("(2,)", f"({size},)"), STATION.replace("zeros(2)", f"zeros({size})")
        prepared.append(resolved(written(tmp_path / name, weather_types=types, station=station)))
    for number, (each, size) in enumerate(zip(prepared, (2, 3), strict=True)):
        run = launcher.run(each, tmp_path / f"run {number}", runtime="inproc")
        assert run.error is None
        assert next(mast.open(run.folder).messages("wind"))["origin"].shape == (size,)


def test_only_a_scenario_that_declares_types_contains_any(windy: Path) -> None:
    with_types = resolved(windy)
    assert [entry["name"] for entry in with_types.to_json()["messages"]] == ["wind"]
    read = Resolved.from_json(json.loads(json.dumps(with_types.to_json())), with_types.wiring)
    assert read.messages == with_types.messages
    _, content = scenario.load("baseline", ["n_infrastructure=1"])
    plain = scenario.resolve(Path("plain"), content, frames=2)
    assert "messages" not in plain.to_json()


def test_a_remote_node_gets_the_file_of_the_type(windy: Path, tmp_path: Path) -> None:
    sent = dict(files_for_node(resolved(windy), "station", tmp_path))
    assert {"files/0/station.py", "files/0/weather_types.py"} <= sent.keys()
    content = sent["scenario.json"]
    assert isinstance(content, bytes)
    assert json.loads(content)["messages"][0]["columns"][1]["unit"] == "m"


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (dict(weather_types=TYPES.replace('"str"', '"text"')), r"station.py:\d+: ValueError.*'text'"),
        (dict(weather_types=TYPES.replace('"wind", 1', '"tracks", 1')), r"station.py:\d+: Type.*'tracks' comes"),
        (
            dict(listener=LISTENER.replace("from weather_types import WIND", TYPES.replace('"wind", 1', '"wind", 2'))),
            r"type 'wind': .*/station.py .*/listener.py",
        ),
        (dict(windy=SCENARIO.replace('message="wind"', 'message="wint"')), "message type 'wint'"),
        (dict(listener=LISTENER.replace('{"wind": WIND}', '{"wind": "tracks"}')), "listener.wind carries 'tracks'"),
    ],
)
def test_an_invalid_type_is_refused_with_its_location(tmp_path: Path, changed: dict[str, str], message: str) -> None:
    with pytest.raises(MastError, match=message) as caught:
        resolved(written(tmp_path, **changed))
    assert isinstance(caught.value, (ConfigurationError, WiringError))


def test_a_type_that_no_node_of_the_scenario_declares_is_unknown(windy: Path, tmp_path: Path) -> None:
    resolved(windy)  # before, another scenario declared it
    changed = {name: FILES[f"{name}.py"].replace("WIND}", '"wind"}') for name in ("station", "listener")}
    (tmp_path / "other").mkdir()
    with pytest.raises(WiringError, match="message type 'wind'"):
        resolved(written(tmp_path / "other", **changed))


def test_columns_that_do_not_match_the_type_are_a_failure_of_the_handler(tmp_path: Path) -> None:
    file = written(tmp_path, station=STATION.replace("np.zeros(2)", "np.zeros(3)"))
    with pytest.raises(MastError, match=r"station.on_clock.*\(3,\).*\(2\)"):
        play(file, tmp_path / "run")


@pytest.mark.mesh
def test_the_mesh_gives_the_same_messages_also_elsewhere(windy: Path, tmp_path: Path) -> None:
    here = launcher.run(resolved(windy, moved=True), tmp_path / "here", runtime="inproc")
    there = launcher.run(resolved(windy, moved=True), tmp_path / "there", engine=Beside())
    assert there.error is None
    found = difference.compare(here.folder, there.folder, taps=True)
    assert found.first is None, "\n".join(explain(found))
    wind = [np.stack([m["velocity"] for m in mast.open(run.folder).messages("wind")]) for run in (here, there)]
    assert np.array_equal(*wind)
