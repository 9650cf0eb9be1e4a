"""Pages whose files and commands are run in order, as a reader would, and whose numbers are checked."""

import json
import os
import re
import signal
import subprocess
import sys
import venv
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import pytest
from containers import base
from launched import eventually, shared_packages
from page_commands import play_page
from PIL import Image

import mast_zenoh as mast
from mast_zenoh import scenario
from mast_zenoh.deploy.ssh import hostsfile
from mast_zenoh.run_folder.recording.difference import compare

pytestmark = [pytest.mark.heavy, pytest.mark.long, pytest.mark.timeout(300)]

DOCS = Path(__file__).parents[2] / "docs"
RUNS_OF_OWN_DATA = ("honest", "attacked", "mine")


def page(name: str) -> str:
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


@pytest.mark.mesh
def test_the_tutorial_works_as_written(tmp_path: Path) -> None:
    folder = play_page(page("tutorial-first-attack"), tmp_path, least=9)
    assert (folder / "study" / "report.html").is_file()


def test_the_page_on_films_works_as_written(tmp_path: Path) -> None:
    folder = play_page(page("how-to-export").split("\n## Films and figures\n")[1], tmp_path, least=4)
    for name, count in (("film.gif", 60), ("slow.gif", 21), ("both.gif", 16)):
        with Image.open(folder / name) as film:
            assert film.n_frames == count
    for name, count in (("film.mp4", 16), ("compared.webm", 16)):
        assert imageio_ffmpeg.count_frames_and_secs(str(folder / name))[0] == count
    assert (folder / "figure.pdf").read_bytes().startswith(b"%PDF")
    assert (folder / "ego.pdf").read_bytes().startswith(b"%PDF")
    assert "<svg" in (folder / "figure.svg").read_text()
    assert (folder / "figure.png").stat().st_size > 10_000
    printed = (folder / "printed").read_text()
    assert "film: film.mp4 (16 images" in printed
    assert "frame 45: figure.svg" in printed


# -- replays -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def replayed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the part on replays of their page was played."""
    part = page("how-to-record-and-replay").partition("\n## Replay a run\n")[2]
    return play_page(part, tmp_path_factory.mktemp("replay"), least=6)


@pytest.mark.mesh
def test_the_page_on_replays_works_as_written(replayed: Path) -> None:
    printed = (replayed / "printed").read_text()
    assert "equal: 60 messages" in printed
    for changed in ("pipeline.clustering.assign_radius", "file, type", "file, type, witnesses"):
        assert f"live: broker, command_center (changed: {changed}), evaluator, recorder" in printed
    assert compare(replayed / "recorded", replayed / "same", wires=("cc/picture",)).first is None
    assert compare(replayed / "recorded", replayed / "wider", wires=("cc/picture",)).first is not None


@pytest.mark.mesh
def test_more_witnesses_remove_false_objects_and_miss_true_ones(replayed: Path) -> None:
    false, missed = (
        [picture(replayed, run, measure) for run in ("recorded", "wider", "witnessed", "strict")]
        for measure in ("fp", "fn")
    )
    assert false[1] > 0.8 * false[0], "another radius is no defence"
    assert false[3] < 0.1 < false[2] < 0.5 * false[0]
    assert missed[0] < missed[2] < missed[3]


# -- the tutorial on one's own data ------------------------------------------------------------------------------------


def test_the_tutorial_on_own_data_works_as_written(tmp_path: Path) -> None:
    folder = play_page(page("tutorial-own-data"), tmp_path, least=7)
    pictures = {name: mast.open(folder / name).summary["agents"]["ego"]["picture"] for name in RUNS_OF_OWN_DATA}
    assert mast.open(folder / "honest").agents == ("ego", "mobile_1", "mobile_2")
    assert pictures["honest"]["tp"]["mean"] > 20
    assert pictures["attacked"]["fp"]["mean"] > pictures["honest"]["fp"]["mean"] + 0.5, "false objects are added"
    assert pictures["mine"]["fn"]["mean"] > pictures["honest"]["fn"]["mean"], "the detector sees no further than 40 m"
    printed = (folder / "printed").read_text()
    for name, picture in pictures.items():
        missed, false = picture["fn"]["mean"], picture["fp"]["mean"]
        assert f"{name:10}{missed:5.1f} missed, {false:4.1f} false objects per frame" in printed


# -- the tutorial on detectors -----------------------------------------------------------------------------------------

DETECTOR = page("tutorial-own-detector").split("\n## ")
#: In place of PyTorch, which no test machine has: what the page uses of it.
TORCH = """
import contextlib

import numpy as np

float32, no_grad, set_num_threads = np.float32, contextlib.nullcontext, print


class Tensor:
    def __init__(self, data):
        self.data = data

    def numpy(self):
        return np.asarray(self.data, np.float32)


def tensor(values, dtype=np.float32):
    return Tensor(np.asarray(values, dtype))


def full(shape, value):
    return tensor(np.full(shape, value))


class nn:
    class Linear:
        def __init__(self, n_in, n_out):
            self.weight, self.bias = Tensor(None), Tensor(None)

        def __call__(self, x):
            return x @ self.weight.data.numpy().T + self.bias.data.numpy()

    class Sequential:
        def __init__(self, *steps):
            self.steps = steps

        def __call__(self, x):
            x = x.numpy()
            for step in self.steps:
                x = step(x)
            return Tensor(x)

    @staticmethod
    def ReLU():
        return lambda x: np.maximum(x, 0)

    @staticmethod
    def Sigmoid():
        return lambda x: 1 / (1 + np.exp(-x))
"""


def parts_of_detectors(folder: Path, *numbers: int, least: int) -> Path:
    """Play these parts of the page, and the first, which writes the detector."""
    return play_page("\n".join(DETECTOR[number] for number in (1, *numbers)), folder, least)


@pytest.mark.mesh
def test_the_tutorial_on_detectors_works_as_written_and_its_table_has_the_measured_numbers(tmp_path: Path) -> None:
    folder = parts_of_detectors(tmp_path, 2, 3, 4, least=6)
    printed = (folder / "printed").read_text()
    assert re.search(r"^20 scans, \d{3} cars, \d+\.\d ms a scan$", printed, flags=re.M)
    assert "made of" in printed, "points become a false object"
    for run, name in (("mine", "`Groups`"), ("shipped", "`ClusterDetector`, the shipped one")):
        ego = json.loads((folder / run / "metrics.json").read_text())["agents"]["ego"]["local"]
        row = f"| {name} | {ego['precision']:.2f} | {ego['recall']:.2f} |"
        assert row in DETECTOR[2]


@pytest.mark.mesh
def test_the_tutorial_on_detectors_runs_a_network_in_onnx(tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="the package that writes the network is not installed")
    pytest.importorskip("onnxruntime", reason="the runtime of ONNX is not installed")
    folder = parts_of_detectors(tmp_path, 5, least=4)
    assert json.loads((folder / "onnx/results/detector_ego/results.json").read_text())["detections"] > 100


@pytest.mark.mesh
def test_the_tutorial_on_detectors_runs_a_network_in_an_environment_of_its_own(tmp_path: Path) -> None:
    venv.create(tmp_path / ".venv-torch", symlinks=True)
    (site,) = (tmp_path / ".venv-torch").glob("lib/python3*/site-packages")
    (site / "torch.py").write_text(TORCH)
    (site / "installed.pth").write_text(shared_packages())
    (commands,) = re.findall(r"^```console\n\$ python -m venv .*?^```$", DETECTOR[6], flags=re.S | re.M)
    DETECTOR[6] = DETECTOR[6].replace(commands, "")
    folder = parts_of_detectors(tmp_path, 6, least=4)
    assert json.loads((folder / "torch/results/detector_ego/results.json").read_text())["detections"] > 100
    assert json.loads((folder / "torch/run.json").read_text())["status"] == "ok"


# -- the tutorial on driving -------------------------------------------------------------------------------------------


def test_the_tutorial_on_driving_works_as_written_and_its_table_has_the_measured_numbers(tmp_path: Path) -> None:
    folder = play_page(page("tutorial-driving"), tmp_path, least=7)
    printed = (folder / "printed").read_text()
    assert "1 passed" in printed
    for run in ("shipped", "honest", "attacked", "vetoed"):
        car = json.loads((folder / run / "metrics.json").read_text())["driven"]["ego"]
        way, braking = f"{car['progress_m']:.0f}", f"{car['hardest_braking_mps2']:.1f}"
        assert f"| {run} | {way} | {braking} |" in page("tutorial-driving")
        assert re.search(rf"^{run} +{way} m, hardest braking {braking} m/s², 0 collisions$", printed, flags=re.M)


# -- the tutorial on defences ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def defended(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the tutorial on defences was played."""
    folder = play_page(page("tutorial-defence"), tmp_path_factory.mktemp("defence"), least=8)
    printed = (folder / "printed").read_text()
    assert "4 passed" in printed
    return folder


def picture(folder: Path, run: str, measure: str = "fp") -> float:
    """A mean per frame of the picture near the ego."""
    metrics = json.loads((folder / run / "metrics.json").read_text())
    return float(metrics["agents"]["ego"]["picture"][measure]["mean"])


def test_the_defence_stops_the_naive_adversary_and_not_the_one_that_knows_it(defended: Path) -> None:
    assert added(defended, "naive_undefended") > 2.0
    assert added(defended, "naive_defended") < 0.3 * added(defended, "naive_undefended")
    assert added(defended, "adaptive_undefended") > 1.0
    assert added(defended, "adaptive_defended") > 0.9 * added(defended, "adaptive_undefended")
    assert picture(defended, "quiet_defended", "fn") == picture(defended, "quiet_undefended", "fn"), "no cost"


def added(folder: Path, run: str) -> float:
    """False objects a frame that an attack adds."""
    return picture(folder, run) - picture(folder, f"quiet_{run.split('_')[1]}")


def test_the_table_of_the_tutorial_has_the_measured_numbers(defended: Path) -> None:
    rows = {"`UncoordinatedAttack`": "naive", "`FewWitnesses`": "adaptive", "none": "quiet"}
    for row, run in rows.items():
        (numbers,) = re.findall(rf"^\| {row} \| ([\d.]+) \| ([\d.]+) \|$", page("tutorial-defence"), flags=re.M)
        for defence, number in zip(("undefended", "defended"), numbers, strict=True):
            assert picture(defended, f"{run}_{defence}") == pytest.approx(float(number), abs=0.3)


def test_the_liar_is_trusted_less_only_if_it_is_naive(defended: Path) -> None:
    found = re.findall(r"^(\w+) trust: (\{.*\})$", (defended / "printed").read_text(), flags=re.M)
    trust = {run: json.loads(text.replace("'", '"')) for run, text in found}
    least = {run: min(values[agent] for agent in values if agent != "infra_1") for run, values in trust.items()}
    assert trust["naive"]["infra_1"] < least["naive"]
    assert trust["adaptive"]["infra_1"] >= least["adaptive"]


# -- commands that are not in one terminal, or not on one machine ------------------------------------------------------


def shell(line: str, folder: Path) -> None:
    """Run the command of a line in a folder."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    options: dict[str, Any] = dict(shell=True, capture_output=True, text=True, check=False)
    process = subprocess.run(line.removeprefix("$ "), cwd=folder, env=environment, **options)
    assert process.returncode == 0, f"{line}\n{process.stdout}{process.stderr}"


@pytest.mark.mesh
def test_every_file_and_command_of_the_page_on_interception_works_as_written(tmp_path: Path) -> None:
    example = page("how-to-intercept").split("## An example")[1].split("\n## ")[0]
    blocks = re.findall(r"^```(console terminal=1|console|python file=(\S+))\n(.*?)^```$", example, flags=re.S | re.M)
    assert len(blocks) == len(re.findall(r"^```\w", example, flags=re.M)) == 4, "a block that no test runs"
    (_, _, first), *files, (_, _, others) = blocks
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    run = subprocess.Popen(first.removeprefix("$ ").split(), cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL)
    record = tmp_path / "watched" / "run.json"
    try:
        for _, file, text in files:
            (tmp_path / file).write_text(text)
        eventually(lambda: record.is_file() and json.loads(record.read_text())["nodes"], "the run begins", 60.0)
        for line in others.splitlines():
            shell(line, tmp_path)
    finally:
        run.send_signal(signal.SIGINT)
        run.wait(60)
    did = [(entry["action"], entry["node"]) for entry in json.loads(record.read_text())["interceptions"]]
    assert did == [(action, name) for name in ("half_1", "late", "mallory") for action in ("intercept", "release")]
    measured = json.loads((tmp_path / "watched" / "metrics.json").read_text())["interposers"]["late"]
    assert measured["effects"]["moved"] > 0


@pytest.mark.mesh
@pytest.mark.timeout(600)
def test_every_command_of_the_page_on_deployment_for_one_machine_works_as_written(tmp_path: Path) -> None:
    here = base()
    blocks = re.findall(r"^```console( image)?\n(.*?)^```$", page("how-to-hosts"), flags=re.S | re.M)
    assert len(blocks) >= 3
    for image, text in blocks:
        for line in text.splitlines():
            assert line.startswith("$ ")
            shell(line.replace("python:3.12-slim", here) if image else line, tmp_path)
    assert (tmp_path / "composed" / "report.html").is_file()


def test_the_example_of_the_page_on_deployment_places_nodes_as_described() -> None:
    text = re.findall(r"^```toml\n(.*?)^```$", page("how-to-hosts"), flags=re.S | re.M)[0]
    path, loaded = scenario.load("uncoordinated")
    nodes = scenario.resolve(path, loaded, frames=2, record=True).nodes
    placed = hostsfile.parse(text, "hosts.toml").placed(nodes)
    assert {spec.role for name, spec in nodes.items() if placed[name] == "there"} == {"agent", "adversary"}
