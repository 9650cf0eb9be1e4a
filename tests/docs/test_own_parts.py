"""Every example of docs/how-to-write-a-part.md, and of docs/examples/, runs as written."""

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.compute as pc
import pytest

import mast_zenoh as mast
from mast_zenoh import testing
from mast_zenoh.arrays.states import Detections
from mast_zenoh.config import loading
from mast_zenoh.run_folder.tables import read_table
from mast_zenoh.scenes.recording import Recording
from mast_zenoh.sensing import Points

pytestmark = pytest.mark.heavy

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "how-to-write-a-part.md").read_text(encoding="utf-8")
EXAMPLES = {path.name: path.read_text("utf-8") for path in sorted((DOCS / "examples").iterdir()) if path.is_file()}
FILES = EXAMPLES | dict(re.findall(r"^```(?:python|toml) file=(\S+)\n(.*?)^```$", PAGE, flags=re.S | re.M))
#: Files whose test is elsewhere: test_outside_program.py, test_plugins.py, test_ros2_nodes_page.py.
ELSEWHERE = {"zenoh_agent.py", "tracker.py", "with_tracker.py", "pyproject.toml", "mast_roadside.py", "near.py"}
COMMANDS = re.findall(r"^```console\n(.*?)^```$", PAGE, flags=re.S | re.M)
FRAMES = 40


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with all these files."""
    made = tmp_path_factory.mktemp("extending")
    for name, text in FILES.items():
        (made / name).write_text(text)
    return made


@pytest.fixture(scope="module")
def play(folder: Path) -> Callable[..., mast.Run]:
    """Plays a file of the page, or a shipped scenario, in this process."""

    def played(name: str, **parameters: Any) -> mast.Run:
        scenario = str(folder / name) if name in FILES else name
        out = folder / " ".join(["run of", name, *map(str, parameters.values())])
        return mast.run(scenario, frames=FRAMES, seed=3, report=False, out=str(out), **parameters)

    return played


@pytest.fixture(scope="module")
def baseline(play: Callable[..., mast.Run]) -> mast.Run:
    """The run that the examples are compared with."""
    return play("baseline")


def picture(run: mast.Run, measure: str) -> float:
    """A metric of the picture near the ego, averaged over the frames."""
    value = run.summary["agents"]["ego"]["picture"][measure]
    return float(value["mean"] if isinstance(value, dict) else value)


def test_the_attack_moves_all_objects_of_its_victim(play: Callable[..., mast.Run]) -> None:
    run = play("pushed.py")
    moved = run.attacks.filter(pc.field("effect") == "moved").to_pylist()
    assert min(row["frame"] for row in moved) == 10
    assert {round(row["after_x"] - row["before_x"], 6) for row in moved} == {3.0}


def test_the_ambush_hides_objects_while_the_ego_is_near(play: Callable[..., mast.Run]) -> None:
    run = play("ambushed.py", near_m=65.0)
    scene = Recording.load(run.path / "scene.npz")
    ego, victim = (scene.agent_position[:FRAMES, scene.agent_names.index(name), :2] for name in ("ego", "infra_1"))
    near = np.flatnonzero(np.hypot(*(ego - victim).T) <= 65.0).tolist()
    removed = {row["frame"] for row in run.attacks.filter(pc.field("effect") == "removed").to_pylist()}
    assert removed == set(near)
    assert 0 < len(near) < FRAMES


def test_the_tracker_follows_detected_objects(play: Callable[..., mast.Run], baseline: mast.Run) -> None:
    run = play("nearest.py")
    assert run.agent("ego").tracks.num_rows > 0
    assert picture(run, "tp") > 0.5 * picture(baseline, "tp")
    assert picture(run, "fp") > picture(baseline, "fp"), "it also tracks clutter"


def test_without_clustering_an_object_is_in_the_picture_several_times(
    play: Callable[..., mast.Run], baseline: mast.Run
) -> None:
    run = play("unclustered.py")
    assert picture(run, "fp") > picture(baseline, "fp") + 1.0


def test_the_fusion_returns_one_member(play: Callable[..., mast.Run], baseline: mast.Run) -> None:
    run = play("surest.py")
    assert picture(run, "tp") > 0.8 * picture(baseline, "tp")
    assert picture(run, "rmse_m") != picture(baseline, "rmse_m")


def test_the_integrity_stage_withholds_what_one_agent_reports_alone(play: Callable[..., mast.Run]) -> None:
    run, undefended = play("crowded_out.py"), play("uncoordinated", n_adversaries=1, attack_start_s=1.0)
    assert picture(run, "fp") < picture(undefended, "fp") - 1.0
    trust = run.trust.to_pylist()
    assert {row["mean"] for row in trust if row["agent"] == "infra_1"} == {0.25, 0.75}


def test_every_second_point_is_removed_and_what_floats_is_refused(folder: Path) -> None:
    file, out = str(folder / "thinned.py"), folder / "run of thinned.py"
    run = mast.run("spoofed", frames=20, seed=3, attack=file, attack_start_s=1.0, checks=file, report=False, out=out)
    assert "removed" in run.attacks["effect"].to_pylist()
    assert min(run.attacks["frame"].to_pylist()) == 10
    position = np.array([[9.0, 0.0, -1.0], [9.0, 4.0, 2.0]])
    zero = np.zeros(2)
    detections = Detections(position, np.full((2, 3), 1.6), zero, zero, zero.astype(np.uint8), np.zeros((2, 3, 3)))
    keep = loading.module(folder / "thinned.py").Grounded().keep(Points.of(np.array([[9.0, 2.0, -1.8]])), detections)
    assert keep.tolist() == [True, False]


def test_the_scene_has_the_requested_number_of_cars(play: Callable[..., mast.Run]) -> None:
    run = play("parked.py", n_cars=2)
    assert np.unique(run.truth["id"].to_numpy()).tolist() == [0, 1, 2]
    assert run.agents == ("ego", "infra_1")
    assert picture(run, "tp") > 1.0


def test_the_detector_sees_nothing_beyond_its_range(play: Callable[..., mast.Run]) -> None:
    run = play("short_sighted.py")
    detections = run.agent("ego").detections
    distance = np.linalg.norm([detections[axis].to_numpy() for axis in "xyz"], axis=0)
    assert 0.0 < distance.max() <= 25.0


def test_the_metric_is_in_the_summary(play: Callable[..., mast.Run]) -> None:
    run = play("alarms.py")
    assert 0.0 < run.summary["agents"]["infra_1"]["picture"]["alarm_share"] <= 1.0


def test_the_link_rule_loses_every_fourth_message(play: Callable[..., mast.Run]) -> None:
    run = play("every_fourth.py")
    lost = run.attacks.filter(pc.field("effect") == "dropped")
    frames = {row["frame"] for row in lost.to_pylist() if row["wire"] == "agent/ego/tracks"}
    assert frames == set(range(3, FRAMES, 4))


def test_the_wire_is_fused_lied_on_lost_and_scored(play: Callable[..., mast.Run]) -> None:
    assert "fuse = true" in FILES["watch.toml"]
    run = play("watchful.py")
    effects = {name: each["wires"] for name, each in run.summary["interposers"].items()}
    assert effects["liar"] == ["agent/infra_1/watch"]
    assert "agent/infra_2/watch" in effects["link_infra_2"]
    agents = run.summary["agents"]
    assert agents["infra_1"]["watch"]["tp"]["mean"] > 0.0
    assert agents["ego"]["picture"]["fp_split"]["attack"] > 0.0


def test_the_fault_jams_its_targets_for_its_duration(play: Callable[..., mast.Run]) -> None:
    run = play("jammed.py")
    lost = run.attacks.filter(pc.field("effect") == "dropped").to_pylist()
    assert {row["interposer"] for row in lost} == {"link_infra_1", "link_infra_2"}
    assert {10 <= row["frame"] < 30 for row in lost} == {True}


def channel(run: mast.Run) -> dict[str, Any]:
    """What the channel carried, by its results."""
    counts: dict[str, Any] = json.loads((run.path / "results" / "channel" / "results.json").read_text())["channel"]
    return counts


def test_the_rules_of_the_radio_say_what_is_sent_and_what_arrives(play: Callable[..., mast.Run]) -> None:
    run = play("on_the_air.py")
    announced = [message.frame for message in run.messages("agent/ego/awareness") if len(message["id"])]
    assert len(announced) > 3
    assert min(np.diff(announced)) >= 5, "the beacon is due twice a second"
    everything, nearby = play("on_the_air.py", redundancy=False), play("on_the_air.py", range_m=10.0)
    assert channel(run)["bytes"] < 0.6 * channel(everything)["bytes"], "others have reported much of it"
    assert channel(nearby)["arrived"] < 0.1 * channel(everything)["arrived"]


def test_own_rules_are_listed_with_their_parameters(folder: Path) -> None:
    (printed,) = carry_out("$ mast list redundancy NearerStation --file on_the_air.py", folder)
    assert "Leaves out objects that a station nearer to them has reported" in printed
    assert "gate_m = 2.0 m" in printed


def test_the_node_counts_the_objects_of_the_picture(play: Callable[..., mast.Run]) -> None:
    run = play("counted.py")
    table = read_table(run.path / "results" / "counter" / "objects.parquet")
    assert table["count"].sum() == run.picture.num_rows > 0


def test_the_wind_is_recorded_with_its_columns(play: Callable[..., mast.Run]) -> None:
    run = play("windy.py")
    speeds = [np.linalg.norm(message["velocity"], axis=1).max() for message in run.messages("wind")]
    assert len(speeds) == FRAMES
    results = json.loads((run.path / "results" / "anemometer" / "results.json").read_text())
    assert results["highest_mps"] == max(speeds)


def test_the_check_is_applied_to_the_run(play: Callable[..., mast.Run]) -> None:
    run = play("checked.py")
    checks = json.loads((run.path / "checks.json").read_text())["checks"]
    (result,) = [check for check in checks if check["name"] == "PictureNeverEmpty"]
    assert result["ok"]
    assert result["detail"] == "0 frames without any object after the first one"


def test_the_figure_is_in_the_report(play: Callable[..., mast.Run]) -> None:
    run = play("crowd.py")
    page = run.report().read_text(encoding="utf-8")
    assert '<h2 id="crowd">How crowded it is</h2>' in page
    assert "Objects in the scene and in the common picture, frame by frame." in page
    assert page.index('id="time"') < page.index('id="crowd"') < page.index('id="wiring"')
    assert (run.path / "figures" / "crowd.png").stat().st_size > 5_000


CHECKS: dict[str, tuple[str, Callable[[Any], None], dict[str, Any]]] = {
    "pushed.py": ("Push", testing.check_attack, {}),
    "ambushed.py": ("Ambush", testing.check_attack, {}),
    "nearest.py": ("NearestTracker", testing.check_tracker, {}),
    "unclustered.py": ("EveryTrackAlone", testing.check_clusterer, {}),
    "surest.py": ("SurestMember", testing.check_fusion, {}),
    "crowded_out.py": ("CrowdedOut", testing.check_integrity, {}),
    "parked.py": ("Parked", testing.check_scene, {}),
    "short_sighted.py": ("ShortSighted", testing.check_detector, {}),
    "alarms.py": ("AlarmShare", testing.check_metric, {}),
    "every_fourth.py": ("EveryNth", testing.check_link_rule, {}),
    "jammed.py": ("Jam", testing.check_fault, dict(at=1.0, until=2.0, node="ego")),
}


@pytest.mark.parametrize("file", CHECKS)
def test_the_class_conforms(folder: Path, file: str) -> None:
    name, check, parameters = CHECKS[file]
    check(getattr(loading.module(folder / file), name)(**parameters))


def test_the_node_conforms(folder: Path) -> None:
    testing.check_node(loading.node_class(folder / "counted.py"))
    testing.check_scenario(folder / "counted.py", frames=5)


def carry_out(commands: str, folder: Path) -> list[str]:
    """The output of each command of a block."""
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    printed = []
    for line in commands.splitlines():
        words = shlex.split(line.removeprefix("$ "))
        process = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        assert process.returncode == 0, f"{line}\n{process.stdout}{process.stderr}"
        printed.append(process.stdout)
    return printed


@pytest.mark.mesh
def test_the_engine_deploys_a_run_equal_to_the_one_in_one_process(folder: Path) -> None:
    assert "polite.py" in FILES
    printed = carry_out(COMMANDS[0], folder)
    assert re.search(r"simulator +exited with 0 +this machine", printed[1])


def test_the_tests_of_the_page_pass(folder: Path) -> None:
    assert "test_pushed.py" in FILES
    (printed,) = carry_out(COMMANDS[1], folder)
    assert "3 passed" in printed


def test_every_file_is_run_by_a_test_and_every_example_is_linked() -> None:
    tests = Path(__file__).read_text()
    assert len(COMMANDS) == 2
    for name in FILES:
        assert f'"{name}"' in tests, f"no test runs {name}"
    pages = "".join(path.read_text("utf-8") for path in DOCS.glob("how-to-*.md"))
    for name in EXAMPLES:
        assert f"(examples/{name})" in pages, f"no page links {name}"
