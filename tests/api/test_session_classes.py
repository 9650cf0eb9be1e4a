"""Scenarios can name classes defined in a notebook, outside any file."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.heavy

DEFINITIONS = '''
import json
import mast_zenoh as mast
from mast_zenoh.attacks import UncoordinatedAttack, UncoordinatedSelection
from mast_zenoh.metrics import FrameMetric
from mast_zenoh.node import Node
from mast_zenoh.scenario import load
from mast_zenoh.scenes import Intersection
from mast_zenoh.sensing import DetectionModel
from mast_zenoh.tracking import KalmanBoxTracker3D

class Many(UncoordinatedSelection):
    """Ten false objects."""
    def __init__(self):
        super().__init__(n_false_positives=10.0)

class Twice(FrameMetric):
    def per_frame(self, estimate):
        return 2 * estimate.count((estimate.outcome == "false") & estimate.is_track)

class Counter(Node):
    role = "counter"
    inputs = {"everything": "*"}
    def __init__(self, start: int = 0):
        self.count = start
    def on_everything(self, received, context):
        self.count += 1
    def finish(self, context):
        return {"count": self.count}

class Junction(Intersection):
    pass

class Tracker(KalmanBoxTracker3D):
    pass

def attack(selection=Many, metric=Twice, node=Counter, start=0):
    scenario = load("uncoordinated", ["n_infrastructure=2", "n_adversaries=1"])[1]
    scenario["adversaries"]["adversary_1"]["attack"] = dict(
        type=UncoordinatedAttack, start_s=0.5, selection=dict(type=selection)
    )
    scenario["scene"] = dict(type=Junction, n_infrastructure=2)
    scenario["agents"]["*"]["pipeline"]["tracker"]["type"] = Tracker
    nodes = dict(counter=dict(role="counter", type=node, start=start))
    return scenario | dict(evaluator=dict(metrics=[dict(type=metric)]), nodes=nodes)
'''


def session(code: str, folder: Path) -> Any:
    """The JSON printed by the last line of code in a session without a file."""
    process = subprocess.run(
        [sys.executable, "-"], input=DEFINITIONS + code, cwd=folder, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    return json.loads(process.stdout.splitlines()[-1])


def test_classes_and_functions_of_a_session_run_in_one_process(tmp_path: Path) -> None:
    code = """
one = mast.run(attack, frames=20, seed=3, start=5)
same = mast.run(attack, frames=20, seed=3, selection="Many", metric="Twice", node="Counter", start=5)
results = [json.loads((run.path / "results/counter/results.json").read_text()) for run in (one, same)]
from mast_zenoh.run_folder.recording.difference import compare
print(json.dumps(dict(
    name=one.name,
    results=results,
    columns=one.metrics.column_names,
    equal=compare(one.path, same.path).first is None,
    inserted=one.attacks.filter([e == "inserted" for e in one.attacks["effect"].to_pylist()]).num_rows,
    listed=mast.list("attacks")["Many"].description,
    nodes=json.loads((one.path / "scenario.json").read_text())["nodes"],
)))
"""
    output = session(code, tmp_path)
    assert output["name"] == "uncoordinated"
    assert output["results"][0] == output["results"][1]
    assert output["results"][0]["count"] > 100
    assert "twice" in output["columns"]
    assert output["equal"]
    assert output["inserted"] > 20
    assert output["listed"] == "Ten false objects"
    attack = output["nodes"]["adversary_1"]["config"]["attack"]
    assert attack["type"] == "UncoordinatedAttack"
    assert attack["selection"] == {"type": "Many"}


def test_a_redefined_class_replaces_the_old_one(tmp_path: Path) -> None:
    code = """
old = Twice
first = mast.run(attack, frames=8, seed=3)
class Twice(FrameMetric):
    def per_frame(self, estimate):
        return 7.0 + 0.0 * estimate.frames
class Junction(Junction):
    def record(self, seed, frames):
        return super().record(seed + 1, frames)
second = mast.run(attack, frames=8, seed=3, metric=Twice)
third = mast.run(attack, frames=8, seed=3, metric=old)
sums = [sum(run.metrics["twice"].to_pylist()) / run.metrics.num_rows for run in (first, second, third)]
print(json.dumps(dict(sums=sums, positions=[run.truth["x"][0].as_py() for run in (first, second)])))
"""
    output = session(code, tmp_path)
    assert output["sums"][1] == 7.0
    assert output["sums"][2] != 7.0
    assert output["positions"][0] != output["positions"][1], (
        "a scene defined in the session is not taken from the cache"
    )


@pytest.mark.parametrize("named", ["Many", "'Many'"])
def test_classes_defined_only_in_a_session_are_refused_on_a_mesh(named: str, tmp_path: Path) -> None:
    code = f"""
try:
    mast.run(attack, frames=5, runtime="mesh", selection={named}, node="Counter")
except mast.MastError as error:
    print(json.dumps([type(error).__name__, str(error)]))
"""
    kind, text = session(code, tmp_path)
    assert kind == "ConfigurationError"
    assert "Counter, Many, Tracker, Twice: defined in this session" in text
    assert "runtime='inproc'" in text


@pytest.mark.mesh
def test_classes_of_a_file_run_as_processes(tmp_path: Path) -> None:
    text = (
        "from mast_zenoh.attacks import UncoordinatedSelection\n\nclass FromFile(UncoordinatedSelection):\n    pass\n"
    )
    (tmp_path / "selections.py").write_text(text)
    code = """
import sys
sys.path.insert(0, ".")
from selections import FromFile
def scenario():
    scenario = load("uncoordinated", ["n_infrastructure=1", "n_adversaries=1"])[1]
    scenario["adversaries"]["adversary_1"]["attack"]["selection"] = dict(type=FromFile)
    return scenario
run = mast.run(scenario, frames=5, runtime="mesh")
print(json.dumps(dict(status=run.status, modules=json.loads((run.path / "scenario.json").read_text())["modules"])))
"""
    output = session(code, tmp_path)
    assert output["status"] == "ok"
    assert output["modules"] == [str(tmp_path / "selections.py")]
