"""`docker-compose up` on a shipped file plays the whole run and ends by itself. Needs Docker."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from containers import built, mast, remnants_of
from equal_runs import assert_equal

from mast_zenoh import scenario
from mast_zenoh.deploy.compose import command
from mast_zenoh.deploy.compose_inside import EXAMPLES
from mast_zenoh.deploy.docker import docker
from mast_zenoh.launch import run as launcher

pytestmark = [pytest.mark.heavy, pytest.mark.mesh, pytest.mark.timeout(600)]

FOLDER = Path(__file__).parents[2] / "deploy" / "compose"
FRAMES = 5
KILLED = ("n_infrastructure=2", "attack_start_s=0.1", "partition_s=0.2", "partition_until_s=0.4", "kill_s=0.5")

Compose = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def compose() -> Iterator[Compose]:
    """Runs docker-compose on a file, in a project of its own; afterwards nothing of it is left."""
    files: list[Path] = []
    environment = {"MAST_IMAGE": built(launcher=True), "MAST_FRAMES": str(FRAMES), "COMPOSE_HTTP_TIMEOUT": "240"}

    def run(file: Path, *words: str, **variables: str) -> subprocess.CompletedProcess[str]:
        files.append(file)
        environ = os.environ | environment | {"COMPOSE_PROJECT_NAME": f"test-{file.stem}"} | variables
        words = (*command(), "--file", str(file), *words)
        return subprocess.run(words, env=environ, capture_output=True, text=True, timeout=400, check=False)

    yield run
    for file in dict.fromkeys(files):
        run(file, "down", "--volumes")
        assert not remnants_of(file.stem)


def codes(run: str) -> dict[str, str]:
    """The state of every container of a run, all of which have ended."""
    rows = docker("ps", "--all", "--filter", f"label=org.mast-zenoh.run={run}", "--format", "{{.Names}}\t{{.Status}}")
    return {name: state.split(") ")[0] for name, state in (row.split("\t") for row in rows.splitlines())}


def results(run: str, output: str, folder: Path) -> Path:
    """The run folder, copied as the output says."""
    (line,) = [line.partition("| ")[2] for line in output.splitlines() if "docker cp" in line]
    _, cp, source, _ = line.split()
    docker(cp, source, str(folder / run))
    return folder / run


@pytest.mark.parametrize("name", EXAMPLES)
def test_docker_compose_up_on_a_shipped_file_ends_by_itself_with_results(
    compose: Compose, name: str, tmp_path: Path
) -> None:
    process = compose(FOLDER / f"{name}.yml", "up", "--no-color")
    assert process.returncode == 0, process.stdout + process.stderr
    states = codes(name)
    assert f"mast-{name}-launcher" in states
    assert set(states.values()) == {"Exited (0"}, (states, process.stdout)
    out = results(name, process.stdout, tmp_path)
    record = json.loads((out / "run.json").read_text())
    assert record["status"] == "ok", record["message"]
    assert record["security"] == EXAMPLES[name][1]
    assert (out / "report.html").is_file()
    path, loaded = scenario.load(EXAMPLES[name][0])
    here = launcher.run(scenario.resolve(path, loaded, frames=FRAMES, record=True), tmp_path / "here", runtime="inproc")
    assert_equal(here.folder, out)
    assert not [path for path in out.rglob("*") if path.is_file() and b"PRIVATE KEY" in path.read_bytes()]


def test_a_node_that_the_scenario_kills_starts_again_in_its_container(compose: Compose, tmp_path: Path) -> None:
    words = [*KILLED, "restart_after_s=0.3"]
    settings = [word for setting in words for word in ("--set", setting)]
    file = tmp_path / "killed.yml"
    written = mast("deploy", "write", "attack_during_partition", *settings, "--secure", "--run", "killed")
    file.write_text(written.stdout)
    process = compose(file, "up", "--no-color", MAST_FRAMES="10")
    assert process.returncode == 0, process.stdout + process.stderr
    out = results("killed", process.stdout, tmp_path)
    record = json.loads((out / "run.json").read_text())
    assert [step["action"] for step in record["steps"]] == ["kill", "start"]
    assert record["nodes"]["infra_2"]["restarts"] == 1
    path, loaded = scenario.load("attack_during_partition", words)
    here = launcher.run(scenario.resolve(path, loaded, frames=10, record=True), tmp_path / "here", runtime="inproc")
    assert_equal(here.folder, out)


def test_the_exit_code_of_the_launcher_is_that_of_compose(compose: Compose) -> None:
    process = compose(FOLDER / "baseline.yml", "up", "--exit-code-from", "launcher", MAST_FRAMES="0")
    assert process.returncode == 2, process.stdout + process.stderr
    assert all(state.startswith("Exited") for state in codes("baseline").values())
