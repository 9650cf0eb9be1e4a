"""A run's twin is a run of the same scenario without its adversaries."""

import json
import shutil
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from equal_runs import run_alone

from mast_zenoh import version
from mast_zenoh.config.loading import OWN_RUN
from mast_zenoh.errors import NotComparable
from mast_zenoh.launch import twin

FRAMES = 30


def played(folder: Path, name: str, *settings: str) -> Path:
    return run_alone(folder, name, *settings, seed=3, frames=FRAMES)


def results(folder: Path) -> dict[str, Any]:
    scores = json.loads((folder / "metrics.json").read_text())
    return {name: scores[name] for name in ("frames", "scored_frames", "agents", "driving")}


@pytest.mark.parametrize("name", ["uncoordinated", "coordinated"])
def test_a_twins_results_equal_the_unattacked_scenarios(tmp_path: Path, name: str) -> None:
    attacked = played(tmp_path / "attacked", name, "attack_start_s=0")
    baseline = played(tmp_path / "baseline", "baseline")
    assert results(attacked) != results(baseline)
    folder = twin.of(attacked)
    assert folder == attacked / "twin"
    assert results(folder) == results(baseline)
    nodes = json.loads((folder / "run.json").read_text())["nodes"]
    assert {node["role"] for node in nodes.values()} == {
        *("simulator", "agent", "broker", "command_center", "evaluator")
    }


def test_a_twin_keeps_links_and_faults(tmp_path: Path) -> None:
    attacked = played(
        tmp_path / "attacked", "attack_during_partition", "partition_s=0.5", "partition_until_s=1.5", "kill_s=2"
    )
    kinds = {each["kind"] for each in json.loads((attacked / "scenario.json").read_text())["timeline"]}
    assert kinds == {"attack", "fault"}
    folder = twin.of(attacked)
    assert {each["kind"] for each in json.loads((folder / "scenario.json").read_text())["timeline"]} == {"fault"}
    assert json.loads((folder / "metrics.json").read_text())["interposers"].keys() == {
        name for name in json.loads((attacked / "metrics.json").read_text())["interposers"] if name.startswith("link")
    }


@pytest.fixture(scope="module")
def attacked_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return played(tmp_path_factory.mktemp("attacked") / "run", "uncoordinated")


@pytest.fixture
def attacked(attacked_run: Path, tmp_path: Path) -> Path:
    """A copy of an attacked run."""
    return shutil.copytree(attacked_run, tmp_path / "attacked")


def run_id(folder: Path) -> str:
    return str(json.loads((folder / "run.json").read_text())["id"])


def test_a_twin_is_played_once_and_again_if_it_is_incomplete_or_of_another_version(
    attacked: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = run_id(twin.of(attacked))
    assert run_id(twin.of(attacked)) == first
    (attacked / "twin" / "metrics.json").unlink()
    second = run_id(twin.of(attacked))
    assert second != first
    later = version.versions() | {"mast-zenoh": "later"}
    monkeypatch.setattr(version, "versions", lambda: later)
    third = run_id(twin.of(attacked))
    assert third not in (first, second)
    assert run_id(twin.of(attacked)) == third


OWN_AGENT = """
from mast_zenoh.config import bundle, loading
from offset import OFFSET

Base = loading.node_class(bundle.ROOT / "nodes" / "agent.py")


class OwnAgent(Base):
    pass
"""


def test_a_twin_is_played_again_if_a_users_file_or_one_next_to_it_changed(tmp_path: Path) -> None:
    user_files = tmp_path / "mine"
    user_files.mkdir()
    (user_files / "own_agent.py").write_text(OWN_AGENT)
    (user_files / "offset.py").write_text("OFFSET = 1\n")
    (user_files / "own.py").write_text(
        "from mast_zenoh.scenario import load\n\n\ndef scenario():\n"
        "    content = dict(load('uncoordinated')[1])\n"
        "    content['agents'] = {'*': {**content['agents']['*'], 'file': 'own_agent.py'}}\n    return content\n"
    )
    attacked = played(tmp_path / "attacked", str(user_files / "own.py"))
    first = run_id(twin.of(attacked, allowed=OWN_RUN))
    assert run_id(twin.of(attacked, allowed=OWN_RUN)) == first
    (user_files / "offset.py").write_text("OFFSET = 2\n")
    second = run_id(twin.of(attacked, allowed=OWN_RUN))
    assert second != first
    assert run_id(twin.of(attacked, allowed=OWN_RUN)) == second


def test_a_folder_that_is_not_a_twin_is_not_touched(attacked: Path) -> None:
    (attacked / "twin").mkdir()
    (attacked / "twin" / "mine.txt").write_text("keep")
    with pytest.raises(NotComparable, match=r"not.*twin"):
        twin.of(attacked)
    assert (attacked / "twin" / "mine.txt").is_file()


def test_a_run_without_its_scenario_or_with_a_broken_one_has_no_twin(attacked: Path) -> None:
    broken = ('{"nodes": 3}', "[]", '{"nodes": {"ego": {"config": 3}}}')
    damages = [*product(("scenario.json", "wiring.json"), (None, *broken)), ("scene.npz", None)]
    for name, content in damages:
        sound = (attacked / name).read_bytes()
        (attacked / name).unlink()
        if content is not None:
            (attacked / name).write_text(content)
        with pytest.raises(NotComparable, match=r"scenario\.json, wiring\.json.*scene\.npz"):
            twin.of(attacked)
        (attacked / name).write_bytes(sound)
    assert twin.of(attacked).is_dir()
