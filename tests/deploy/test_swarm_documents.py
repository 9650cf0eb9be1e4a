"""Stack files and Docker's output about stacks, without a Docker engine."""

from __future__ import annotations

import contextlib
import string
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh import kernels, scenario
from mast_zenoh.config.process_steps import ProcessStep
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy import numeric_environment
from mast_zenoh.deploy.compose import document as compose
from mast_zenoh.deploy.swarm import document, engine, placement, services, stack, tasks
from mast_zenoh.deploy.swarm.placement import Machine
from mast_zenoh.deploy.swarm.services import Services
from mast_zenoh.deploy.swarm.tasks import Task
from mast_zenoh.errors import ConfigurationError, EngineError

RUN = "uncoordinated-00c0ffee"
HERE = Machine("id-here", "here", True, {"mast.host": "west"})
THERE = Machine("id-there", "there", True, {"mast.host": "east"})


@pytest.fixture(scope="module")
def resolved() -> Resolved:
    path, loaded = scenario.load("uncoordinated", ["n_infrastructure=2", "n_adversaries=1", "n_mobile=1"])
    resolved_scenario = scenario.resolve(path, loaded, frames=2)
    changed = {"infra_2": replace(resolved_scenario.nodes["infra_2"], on_exit="restart")}
    return replace(resolved_scenario, nodes=resolved_scenario.nodes | changed)


def stacked(resolved: Resolved, **options: Any) -> dict[str, Any]:
    return document.document(resolved, RUN, image="sha256:1", port=7000, here="id-here", **options)


def test_every_node_is_a_service_with_one_task_and_a_limit(resolved: Resolved) -> None:
    services_by_name = stacked(resolved, absent=["infra_1"])["services"]
    assert services_by_name.keys() == {"router", *resolved.nodes}
    for name, service in services_by_name.items():
        deploy = service["deploy"]
        assert deploy["replicas"] == (0 if name == "infra_1" else 1)
        assert deploy["endpoint_mode"] == "dnsrr", "a kernel without IPVS has no virtual addresses"
        assert deploy["resources"]["limits"].keys() == {"cpus", "memory", "pids"}


def test_a_stack_file_has_no_compose_only_keys(resolved: Resolved) -> None:
    content = stacked(resolved, secure="acl", environment={"OPENBLAS_CORETYPE": "Haswell"})
    known = {"image", "user", "init", "read_only", "cap_drop", "healthcheck", "volumes", "stop_grace_period"}
    known |= {"command", "networks", "ports", "secrets", "deploy", "environment", "<<"}
    assert set(content["x-node"]) <= known
    assert content["x-node"]["environment"] == {"OPENBLAS_CORETYPE": "Haswell"}
    for service in content["services"].values():
        assert set(service) <= known


def test_nodes_get_the_same_commands_as_from_compose(resolved: Resolved) -> None:
    composed = compose.document(resolved, RUN, image="sha256:1", secure="acl")["services"]
    for name, service in stacked(resolved, secure="acl")["services"].items():
        assert service["command"] == composed[name]["command"]
        assert service["networks"] == composed[name]["networks"]


def test_docker_restarts_only_nodes_with_a_restart_policy(resolved: Resolved) -> None:
    policies = {name: s["deploy"]["restart_policy"] for name, s in stacked(resolved)["services"].items()}
    assert policies.pop("infra_2") == {"condition": "on-failure", "delay": "2s", "max_attempts": 5}
    assert {policy["condition"] for policy in policies.values()} == {"none"}


def test_the_router_is_restarted_only_in_real_time(resolved: Resolved) -> None:
    for mode, condition in (("lockstep", "none"), ("realtime", "on-failure")):
        router = stacked(replace(resolved, mode=mode))["services"]["router"]
        assert router["deploy"]["restart_policy"]["condition"] == condition


def test_mobile_agents_have_their_own_network_and_no_node_has_external_access(resolved: Resolved) -> None:
    content = stacked(resolved)
    assert {network["driver"] for network in content["networks"].values()} == {"overlay"}
    assert content["networks"]["wired"]["internal"]
    assert content["networks"]["wireless"]["internal"]
    networks_by_node = {name: service["networks"] for name, service in content["services"].items()}
    assert networks_by_node.pop("router") == ["launcher", "wired", "wireless"]
    assert {name for name, networks in networks_by_node.items() if networks == ["wireless"]} == {"ego", "mobile_1"}


def test_the_router_and_nodes_killed_by_the_scenario_are_on_the_launchers_machine(resolved: Resolved) -> None:
    steps = (ProcessStep(3, "kill", "infra_1"), ProcessStep(5, "start", "infra_1"), ProcessStep(4, "leave", "broker"))
    place = placement.resolve({"infra_*": "west"}, resolved.nodes)
    services = stacked(resolved, place=place, pinned=placement.pinned(steps))["services"]
    constraints = {name: s["deploy"].get("placement", {}).get("constraints", []) for name, s in services.items()}
    west = "node.labels.mast.host == west"
    assert constraints["router"] == ["node.id == id-here"]
    assert constraints["infra_1"] == ["node.id == id-here", west]
    assert constraints["infra_2"] == [west]
    assert constraints["broker"] == [], "a node to be disconnected may run on any machine"


def test_only_the_nodes_user_can_read_secrets_which_are_named_by_their_files(resolved: Resolved) -> None:
    content = stacked(resolved, secure="acl")
    for name, service in content["services"].items():
        names = {"router.json"} if name == "router" else {"ca.pem", "certificate.pem", "key.pem", "control.json"}
        assert {secret["target"] for secret in service["secrets"]} == names
        assert {(s["uid"], s["gid"], s["mode"]) for s in service["secrets"]} == {("10001", "10001", 0o600)}
        assert all(content["secrets"][secret["source"]]["file"].startswith("./") for secret in service["secrets"])
    assert "secrets" not in stacked(resolved)


def test_the_router_is_checked_often_because_its_name_resolves_only_when_healthy(resolved: Resolved) -> None:
    stack_file = stacked(resolved)
    assert stack_file["services"]["router"]["healthcheck"]["interval"] == "2s"
    assert stack_file["services"]["router"]["healthcheck"]["test"] == stack_file["x-node"]["healthcheck"]["test"]


@given(name=st.text(alphabet=string.ascii_letters + string.digits + "_-.é ", min_size=1, max_size=60))
def test_every_accepted_name_is_a_valid_dns_label(resolved: Resolved, name: str) -> None:
    one = replace(resolved, nodes={name: resolved.nodes["broker"]})
    label = document.service(RUN, name)
    with contextlib.suppress(ConfigurationError):
        document.check_names(one)
        assert len(label) <= 63
        assert label.replace("_", "").replace("-", "").isascii()
        assert label.replace("_", "").replace("-", "").isalnum()
        assert label[-1].isalnum()


def test_a_pattern_without_matching_nodes_is_refused_with_the_nearest_name(resolved: Resolved) -> None:
    with pytest.raises(ConfigurationError, match=r"--place brokr: there is no such node; did you mean 'broker'\?"):
        placement.resolve({"brokr": "west"}, resolved.nodes)
    assert placement.resolve({"infra_1": "east", "infra_*": "west"}, ["infra_1", "infra_2", "ego"]) == {
        "infra_1": "east",
        "infra_2": "west",
    }


def test_a_host_label_that_no_machine_has_is_refused() -> None:
    with pytest.raises(EngineError, match=r"infra_1: no machine .* mast.host=wst; did you mean 'west'\?.*label-add"):
        placement.check([HERE, THERE], {"infra_1": "wst"}, ())
    drained = THERE._replace(usable=False)
    with pytest.raises(EngineError, match=r"mast\.host=east"):
        placement.check([HERE, drained], {"infra_1": "east"}, ())
    with pytest.raises(EngineError, match="this machine takes no tasks"):
        placement.check([HERE._replace(usable=False)], {}, ())
    placement.check([HERE, THERE], {"infra_1": "east"}, ())


def test_a_node_killed_by_the_scenario_cannot_be_placed_on_another_machine() -> None:
    with pytest.raises(
        EngineError, match=r"infra_1: the scenario kills or pauses it, .*here.* found it placed on .*east"
    ):
        placement.check([HERE, THERE], {"infra_1": "east"}, {"infra_1"})
    placement.check([HERE, THERE], {"infra_1": "west"}, {"infra_1"})


def line(identity: str, state: str, error: str = "", node: str = "infra_1", desired_state: str = "Running") -> str:
    return f"{identity}\t{document.service(RUN, node)}.1\there\t{desired_state}\t{state}\t{error}"


@pytest.mark.parametrize(
    ("state", "code"),
    [
        (("Running 3 seconds ago",), None),
        (("Preparing less than a second ago",), None),
        (("Complete 2 seconds ago",), 0),
        (("Failed 2 seconds ago", '"task: non-zero exit (3)"'), 3),
        (("Failed 2 seconds ago", '"task: non-zero exit (137)"'), -9),
        (("Failed 1 second ago", '"task: non-zero exit (137): dockerexec: unhealthy container"'), -9),
        (("Rejected 1 second ago", '"No such image: sha256:1"'), 125),
        (("Shutdown 1 second ago",), -15),
    ],
)
def test_the_exit_code_of_a_task_is_read_from_docker(state: tuple[str, ...], code: int | None) -> None:
    task_states = tasks.parse(document.stack(RUN), [line("t1", *state)])
    assert [task.exit for task in task_states["infra_1"]] == [code]


def test_a_task_that_was_not_started_has_the_reason_from_docker() -> None:
    (task,) = tasks.parse(document.stack(RUN), [line("t1", "Rejected 1 second ago", '"No such image: sha256:1"')])[
        "infra_1"
    ]
    assert task.refused.startswith("here: No such image: sha256:1; no registry has it")
    (task,) = tasks.parse(document.stack(RUN), [line("t1", "Failed 1 second ago", '"task: non-zero exit (3)"')])[
        "infra_1"
    ]
    assert task.refused == ""


@given(st.lists(st.text(max_size=80)))
def test_any_output_of_docker_is_parsed_without_an_error(lines: list[str]) -> None:
    for history in tasks.parse(document.stack(RUN), lines).values():
        assert all(isinstance(task.exit, int | None) and isinstance(task.refused, str) for task in history)


class Engine:
    """A stand-in for Docker: scripted task states, recorded commands."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.tasks: list[Task] = []
        self.told: list[tuple[str, ...]] = []
        self.now = 0.0
        monkeypatch.setattr(services, "docker", self.docker)
        self.router = Task("r1", "router", "here", "running", "running", "")
        monkeypatch.setattr(tasks, "of", lambda stack: {"infra_2": list(self.tasks), "router": [self.router]})
        monkeypatch.setattr(services, "keep_logs", lambda logs: self.told.extend(("log", task) for task, *_ in logs))
        monkeypatch.setattr(services.time, "monotonic", lambda: self.now)

    def docker(self, *words: str, **_: Any) -> str:
        self.told.append(words)
        return "x"

    def say(self, *states: tuple[str, str, str]) -> None:
        self.now += 1.0
        self.tasks = [Task(identity, "infra_2", "here", "running", state, error) for identity, state, error in states]


@pytest.fixture
def dockerd(monkeypatch: pytest.MonkeyPatch) -> Engine:
    return Engine(monkeypatch)


def supervised(resolved: Resolved, tmp_path: Path, mode: str = "lockstep") -> Services:
    (tmp_path / "logs").mkdir()
    supervisor = Services(
        document.stack(RUN), lambda name: document.service(RUN, name), "here", tmp_path / "logs", mode
    )
    supervisor.start_all({"infra_2": resolved.nodes["infra_2"]})
    return supervisor


KILLED = "task: non-zero exit (137)"


def test_a_node_restarted_by_docker_has_ended_and_runs_again(
    resolved: Resolved, tmp_path: Path, dockerd: Engine
) -> None:
    supervisor = supervised(resolved, tmp_path)
    (child,) = supervisor.children.values()
    dockerd.say(("t1", "running", ""))
    assert supervisor.running() == [child]
    assert supervisor.newly_ended() == []
    dockerd.say(("t2", "preparing", ""), ("t1", "failed", KILLED))
    assert supervisor.running() == []
    assert supervisor.newly_ended() == [child]
    assert (child.exit, supervisor.newly_ended()) == (-9, [])
    assert supervisor.restart(child)
    assert (child.exit, child.restarts) == (None, 1)
    assert dockerd.told == [("log", "t1")], "nothing was scaled"
    dockerd.say(("t2", "complete", ""), ("t1", "failed", KILLED))
    supervisor.running()
    assert supervisor.newly_ended() == [child]
    assert child.exit == 0


def test_a_node_that_fails_twice_between_two_polls_has_ended_twice(
    resolved: Resolved, tmp_path: Path, dockerd: Engine
) -> None:
    supervisor = supervised(resolved, tmp_path)
    (child,) = supervisor.children.values()
    dockerd.say(("t3", "running", ""), ("t2", "failed", "task: non-zero exit (3)"), ("t1", "failed", KILLED))
    codes = []
    while not supervisor.running():
        assert supervisor.newly_ended() == [child]
        codes.append(child.exit)
        assert supervisor.restart(child)
    assert codes == [-9, 3]


def test_a_node_without_a_suitable_machine_ends_the_run_with_the_reason_from_docker(
    resolved: Resolved, tmp_path: Path, dockerd: Engine
) -> None:
    supervisor = supervised(resolved, tmp_path)
    dockerd.say(("t1", "pending", "no suitable node (insufficient resources on 1 node)"))
    assert supervisor.running()
    dockerd.now += 31.0
    with pytest.raises(
        EngineError, match=r"infra_2: Docker has found no machine .* \(insufficient resources on 1 node\)"
    ):
        supervisor.running()


def test_a_lock_step_run_does_not_survive_its_router(resolved: Resolved, tmp_path: Path, dockerd: Engine) -> None:
    supervisor = supervised(resolved, tmp_path)
    dockerd.say(("t1", "running", ""))
    assert supervisor.running()
    dockerd.router = dockerd.router._replace(state="failed", error=KILLED)
    dockerd.say(("t1", "running", ""))
    with pytest.raises(EngineError, match=r"the router has ended: killed by signal 9 .*; see logs/router\.log"):
        supervisor.running()


def test_a_real_time_run_waits_for_its_router_for_a_limited_time(
    resolved: Resolved, tmp_path: Path, dockerd: Engine
) -> None:
    supervisor = supervised(resolved, tmp_path, "realtime")
    there, failed = dockerd.router, dockerd.router._replace(state="failed", error=KILLED)
    for dockerd.router in (there, failed, failed, there, failed, failed, failed):
        dockerd.say(("t1", "running", ""))
        assert supervisor.running()
    dockerd.now += 10.0
    with pytest.raises(EngineError, match="the router has ended"):
        supervisor.running()


def test_killing_a_node_on_another_machine_is_refused_with_the_reason(
    resolved: Resolved, tmp_path: Path, dockerd: Engine
) -> None:
    supervisor = supervised(resolved, tmp_path)
    (child,) = supervisor.children.values()
    dockerd.say(("t1", "running", ""))
    dockerd.tasks = [task._replace(machine="there") for task in dockerd.tasks]
    supervisor.running()
    for doing in (supervisor.kill, supervisor.pause):
        with pytest.raises(
            EngineError, match=r"infra_2 cannot be .*: Docker does that only on its own machine.*on there"
        ):
            doing(child)
    assert dockerd.told == []


def test_docker_may_be_unavailable_only_for_a_short_time(
    resolved: Resolved, tmp_path: Path, dockerd: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    supervisor = supervised(resolved, tmp_path)
    dockerd.say(("t1", "running", ""))
    supervisor.running()

    def silent(stack: str) -> None:
        raise EngineError("the Docker engine cannot be reached")

    monkeypatch.setattr(tasks, "of", silent)
    dockerd.now += 10.0
    assert supervisor.running()
    dockerd.now += 30.0
    with pytest.raises(EngineError, match="cannot be reached"):
        supervisor.running()


@pytest.mark.parametrize(
    ("swarm_state", "reason"),
    [
        ("inactive false", r"not in a swarm: create one with `docker swarm init --advertise-addr 127\.0\.0\.1`"),
        ("locked false", "the swarm of this machine is locked"),
        ("active false", "is a worker of its swarm"),
        ("active true", None),
    ],
)
def test_a_worker_cannot_deploy_a_stack(monkeypatch: pytest.MonkeyPatch, swarm_state: str, reason: str | None) -> None:
    monkeypatch.setattr(engine, "docker", lambda *words: swarm_state + "\n")
    if reason is None:
        engine.check_manager()
    else:
        with pytest.raises(EngineError, match=reason):
            engine.check_manager()


def test_the_engine_of_another_machine_is_refused() -> None:
    with pytest.raises(EngineError, match="DOCKER_HOST is tcp://there:2375: expected the engine of this machine"):
        engine.check_here({"DOCKER_HOST": "tcp://there:2375"})
    engine.check_here({"DOCKER_HOST": "unix:///var/run/docker.sock"})
    engine.check_here({})


@pytest.mark.parametrize(
    ("output", "expected"),
    [
        ('["registry.example/mast@sha256:2"]\tsha256:1\n', "registry.example/mast@sha256:2"),
        ("[]\tsha256:1\n", "sha256:1"),
    ],
)
def test_all_machines_run_the_same_image(monkeypatch: pytest.MonkeyPatch, output: str, expected: str) -> None:
    monkeypatch.setattr(engine, "docker", lambda *words: output)
    assert engine.reference("mast") == expected


def test_router_settings_that_are_too_large_for_a_secret_are_refused(tmp_path: Path) -> None:
    settings = tmp_path / "router.json"
    settings.write_bytes(b" " * 500_000)
    engine.check_size(settings)
    settings.write_bytes(b" " * 500_001)
    with pytest.raises(EngineError, match="are 500001 bytes: a secret of a swarm is at most 500000"):
        engine.check_size(settings)


def test_a_machine_without_a_swarm_has_only_containers_of_a_stack(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def docker(*words: str, **_: Any) -> str:
        asked.append(words[0])
        return "inactive" if words[0] == "info" else ""

    monkeypatch.setattr(stack, "docker", docker)
    stack.remove("mast-1")
    assert asked == ["info", "container", "network"]


def test_remote_nodes_get_only_the_variables_that_affect_floating_point_results() -> None:
    ours = {"OPENBLAS_CORETYPE": "Haswell", "OPENBLAS_NUM_THREADS": "2", "HOME": "/somewhere"}
    environment = numeric_environment.environment(ours)
    assert environment.pop("MAST_KERNELS", kernels.USED) == kernels.USED
    assert environment == {"OPENBLAS_CORETYPE": "Haswell"}
