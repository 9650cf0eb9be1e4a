"""Composed runs, and those of shipped files by themselves, equal local ones and leave nothing behind. Needs Docker."""

import json
import os
import signal
import subprocess
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from compose_examples import EXAMPLES
from containers import built, mast, remnants_of
from equal_runs import assert_equal, run_alone
from launched import MAST, Launched, eventually

from mast_zenoh.deploy.compose import command
from mast_zenoh.deploy.docker import docker
from mast_zenoh.mesh.hosting import UP
from mast_zenoh.run_folder.recording.reader import read

pytestmark = [pytest.mark.heavy, pytest.mark.long, pytest.mark.mesh, pytest.mark.timeout(600)]
PARTITION = ("n_infrastructure=2", "attack_start_s=0.1", "partition_s=0.2", "partition_until_s=0.4")
RESTARTED = (*PARTITION, "kill_s=0.5", "restart_after_s=0.3")
FOLDER = Path(__file__).parents[2] / "deploy" / "compose"
FRAMES = 5

Compose = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture
def up(start: Callable[..., Launched]) -> Callable[..., Launched]:
    """Starts composed runs; removes their remnants."""
    how = ("--engine", "compose", "--image", built(), "--no-report", "--out")
    return lambda *words: start(*MAST, "deploy", "up", *words, *how, afterwards=take_down)


def take_down(run: Launched) -> None:
    if "deployment" in run.record():
        mast("deploy", "down", str(run.out))
        assert not remnants_of(run.record()["id"])


def settings(of: tuple[str, ...]) -> list[str]:
    return [word for setting in of for word in ("--set", setting)]


def here(name: str, of: tuple[str, ...], frames: int, out: Path) -> Path:
    """The folder of the same run in one process."""
    return run_alone(out, name, *of, frames=frames, record=True)


def ended(run: Launched, expected: int = 0) -> dict[str, Any]:
    """run.json of a run that has ended with this code, and of which nothing is left."""
    run.ended(expected)
    record = run.record()
    assert not remnants_of(record["id"])
    return record


def test_a_secure_composed_run_with_a_restarted_node_equals_the_local_one(up, tmp_path: Path) -> None:
    run = up("attack_during_partition", "--frames", "10", "--secure", *settings(RESTARTED))
    plain = here("attack_during_partition", RESTARTED, 10, tmp_path / "here")
    record = ended(run)
    assert [step["action"] for step in record["steps"]] == ["kill", "start"]
    assert record["nodes"]["infra_2"]["restarts"] == 1
    assert_equal(plain, run.out)
    assert record["security"] == "acl"
    assert all(node["exit"] == 0 and node["container"] and node["clock"] for node in record["nodes"].values())


FAULTY = """
from mast_zenoh import scenario as scenarios


def scenario():
    _, loaded = scenarios.load("baseline", ["n_infrastructure=1"])
    return loaded | dict(faults={faults})
"""


def faulty(folder: Path, **times: tuple[float, float]) -> str:
    """The file of a scenario with faults of infra_1: of each type, begin and end in s."""
    path = folder / "faulty.py"
    faults = [dict(type=kind, node="infra_1", at=at, until=until) for kind, (at, until) in times.items()]
    path.write_text(FAULTY.format(faults=faults))
    return str(path)


def test_a_node_that_is_paused_and_later_disconnected_is_silent_and_returns(up, tmp_path: Path) -> None:
    run = up(faulty(tmp_path, Pause=(0.7, 1.2), Unplug=(2.0, 5.0)), "--mode", "realtime", "--frames", "110")
    record = ended(run)
    assert [step["action"] for step in record["steps"]] == ["pause", "resume", "disconnect", "connect"]
    assert record["nodes"]["infra_1"]["exit"] == 0
    assert record["nodes"]["infra_1"]["restarts"] == 0, "it is the same process"
    frames = {message.frame for message in read(run.out / "messages.mcap") if message.key == "agent/infra_1/tracks"}
    assert {5, 18} < frames, "before"
    assert not frames & set(range(30, 45)), "the link is cut"
    assert max(frames) >= 105, "it reconnects by itself and rejoins at the current frame"
    checks = json.loads((run.out / "checks.json").read_text())["checks"]
    failed = [check for check in checks if not check["ok"]]
    # If the machine stands still for a moment, the router drops messages in real time: the check of sequences says it.
    assert all(check["name"] == "sequences" and "repeated" not in check["detail"] for check in failed), failed


def test_a_node_disconnected_at_the_end_still_delivers_its_results(up, tmp_path: Path) -> None:
    run = up(faulty(tmp_path, Unplug=(1.0, 60.0)), "--mode", "realtime", "--patience", "5")
    where = run.started()["nodes"]["infra_1"]["container"]
    networks = "{{len .NetworkSettings.Networks}}"
    eventually(
        lambda: docker("inspect", "--format", networks, where).strip() == "0",
        "infra_1 is disconnected from its networks",
    )
    eventually(lambda: UP not in docker("exec", where, "ls", "/tmp"), "the node has noticed")
    run.process.send_signal(signal.SIGINT)
    node = ended(run, 130)["nodes"]["infra_1"]
    assert node["last_frame"] is not None, node


def test_ctrl_c_keeps_the_results_obtained_so_far_and_leaves_nothing_running(up) -> None:
    run = up("baseline", "--secure", "--mode", "realtime", "--rate", "0.5", *settings(("n_infrastructure=1",)))
    recording = run.out / "messages.mcap"
    run.until(lambda: recording.is_file() and recording.stat().st_size > 20_000, "the recording grows on this machine")
    record = run.record()
    inside = docker("exec", record["nodes"]["ego"]["container"], "stat", "-c", "%a %u", "/run/secrets/key.pem").split()
    assert inside == ["600", docker("exec", record["nodes"]["ego"]["container"], "id", "-u").strip()]
    assert inside[1] != "0", "no process runs as root"
    assert "PRIVATE" not in docker("inspect", *(node["container"] for node in record["nodes"].values()))
    reached = docker("network", "inspect", "--format", "{{.Internal}}", f"mast-{record['id']}_wired")
    assert reached.strip() == "true", "nodes reach only the router"
    status = mast("deploy", "status", str(run.out)).stdout
    assert all(name in status for name in (*record["nodes"], "router")), status
    words = ("--network", f"mast-{record['id']}_wired", "--entrypoint", "sleep", built(), "600")
    foreign = docker("run", "--detach", "--name", f"foreign-{os.getpid()}", *words).strip()
    try:
        run.process.send_signal(signal.SIGINT)
        assert ended(run, 130)["status"] == "interrupted", "also with a foreign container on a network of the run"
        assert docker("inspect", "--format", "{{.State.Running}}", foreign).strip() == "true", "it is not ours to end"
    finally:
        docker("rm", "--force", foreign)
    assert json.loads((run.out / "metrics.json").read_text())["frames"] > 0
    assert sum(1 for _ in read(recording)) > 0
    assert not [path for path in run.out.rglob("*") if path.is_file() and b"PRIVATE KEY" in path.read_bytes()]
    assert not (run.out / "credentials").exists()


def test_nodes_of_a_killed_launcher_exit_and_down_removes_the_remainder(up) -> None:
    words = settings(("n_infrastructure=1",))
    run = up("baseline", "--secure", "--mode", "realtime", "--rate", "0.5", "--patience", "2", *words)
    run.until(run.recorded, "the run continues")
    record = run.record()
    run.kill()
    label = f"label=org.mast-zenoh.run={record['id']}"
    eventually(
        lambda: not docker("ps", "--quiet", "--filter", label).split(), "all containers have ended by themselves"
    )
    assert remnants_of(record["id"]), "the containers are kept for their logs"
    process = mast("deploy", "down", str(run.out))
    assert process.returncode == 0, process.stdout + process.stderr
    assert not remnants_of(record["id"])
    assert not (run.out / "credentials").exists()
    assert mast("deploy", "down", str(run.out)).returncode == 0, "repeating it does no harm"


# -- docker-compose up on a file, without mast ----------------------------------------------------------------------


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
        down = run(file, "down", "--volumes")
        if miscounted(file.stem, down.stderr):
            warnings.warn(
                f"the engine must be restarted before it can remove the networks: {down.stderr}", stacklevel=1
            )
            docker("volume", "rm", f"mast-{file.stem}-results")
        else:
            assert not remnants_of(file.stem), down.stdout + down.stderr


def miscounted(run: str, said: str) -> bool:
    """Whether the engine refuses to remove the networks of this run for endpoints that it does not have.

    Its count of them can be wrong. Then nothing but its restart helps, which reports an "inconsistent endpoint_cnt".
    """
    left = remnants_of(run)
    if "has active endpoints" not in said or "containers" in left:
        return False
    return {
        docker("network", "inspect", "--format", "{{len .Containers}}", name).strip()
        for name in left.get("network", [])
    } == {"0"}


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


def test_docker_compose_up_on_a_shipped_file_ends_by_itself_with_results(compose: Compose, tmp_path: Path) -> None:
    name = "coordinated"  # tests/deploy/test_documents.py compares all files with what is generated
    process = compose(FOLDER / f"{name}.yml", "up", "--no-color")
    assert process.returncode == 0, process.stdout + process.stderr
    states = codes(name)
    assert f"mast-{name}-launcher" in states
    failed = [container for container, state in states.items() if state != "Exited (0"]
    assert not failed, process.stdout
    out = results(name, process.stdout, tmp_path)
    record = json.loads((out / "run.json").read_text())
    assert record["status"] == "ok", record["message"]
    assert record["security"] == EXAMPLES[name][1]
    assert (out / "report.html").is_file()
    assert_equal(here(EXAMPLES[name][0], (), FRAMES, tmp_path / "here"), out)
    assert not [path for path in out.rglob("*") if path.is_file() and b"PRIVATE KEY" in path.read_bytes()]


def test_a_node_that_the_scenario_kills_starts_again_in_its_container(compose: Compose, tmp_path: Path) -> None:
    file = tmp_path / "killed.yml"
    words = ("attack_during_partition", *settings(RESTARTED), "--secure", "--run", "killed")
    file.write_text(mast("deploy", "write", *words).stdout)
    process = compose(file, "up", "--no-color", MAST_FRAMES="10")
    assert process.returncode == 0, process.stdout + process.stderr
    out = results("killed", process.stdout, tmp_path)
    record = json.loads((out / "run.json").read_text())
    assert [step["action"] for step in record["steps"]] == ["kill", "start"]
    assert record["nodes"]["infra_2"]["restarts"] == 1
    assert_equal(here("attack_during_partition", RESTARTED, 10, tmp_path / "here"), out)


def test_the_exit_code_of_the_launcher_is_that_of_compose(compose: Compose) -> None:
    process = compose(FOLDER / "baseline.yml", "up", "--exit-code-from", "launcher", MAST_FRAMES="0")
    assert process.returncode == 2, process.stdout + process.stderr
    assert all(state.startswith("Exited") for state in codes("baseline").values())
