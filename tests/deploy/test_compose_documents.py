"""Generated compose files: readable, valid for Compose, reproducible."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from mast_zenoh import scenario
from mast_zenoh.cli.app import app
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy.compose import document, inside
from mast_zenoh.deploy.compose.examples import EXAMPLES, example
from mast_zenoh.deploy.yamltext import dump
from mast_zenoh.errors import BackendError, ConfigurationError

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "deploy" / "compose"

CREDENTIALS = {"ca.pem", "certificate.pem", "key.pem", "control.json"}

TEXT = st.text(st.characters(exclude_categories=["Cs"]))
PLAIN = st.one_of(st.booleans(), st.integers(-5, 5), st.floats(allow_nan=False, allow_infinity=False), TEXT)
KEYS = TEXT.filter(bool)
NESTED = st.recursive(
    st.one_of(PLAIN, st.lists(PLAIN, max_size=3)),
    lambda inner: st.one_of(
        st.dictionaries(KEYS, inner, max_size=3),
        st.lists(st.dictionaries(KEYS, inner, min_size=1, max_size=3), max_size=3),
    ),
    max_leaves=5,
)


@settings(max_examples=50)
@given(st.dictionaries(KEYS, NESTED, max_size=4))
def test_dumped_values_are_read_back_unchanged(content: dict) -> None:
    def doubled(value):
        if isinstance(value, dict):
            return {doubled(key): doubled(item) for key, item in value.items()}
        if isinstance(value, list):
            return [doubled(item) for item in value]
        return value.replace("$", "$$") if isinstance(value, str) else value

    assert (yaml.safe_load(dump(content)) or {}) == doubled(content)


@pytest.mark.parametrize("newline", ["\n", "\r", "\x85", "\u2028", "\u2029"])
@pytest.mark.parametrize("inside", [True, False])
def test_a_name_adds_no_line_to_the_file(newline: str, inside: bool) -> None:
    def written(name: str) -> str:
        path, content = scenario.load("baseline")
        resolved = replace(scenario.resolve(path, content, frames=1), name=name)
        launcher = document.Launcher("baseline") if inside else None
        return document.text(resolved, name, image="mast", launcher=launcher)

    hostile = written(f"plain{newline}services: {{}}")
    assert len(hostile.splitlines()) == len(written("plain").splitlines())
    assert yaml.safe_load(hostile).keys() == yaml.safe_load(written("plain")).keys()


def test_a_name_of_a_run_that_is_not_one_is_refused() -> None:
    result = CliRunner().invoke(app, ["deploy", "write", "baseline", "--run", "a\nservices: {}"])
    assert isinstance(result.exception, ConfigurationError)
    assert "--run: found 'a\\nservices: {}', expected at most 100 characters" in str(result.exception)


def test_the_file_names_the_command_that_builds_its_images_without_a_registry() -> None:
    assert "`mast deploy image --launcher`" in example("baseline")
    assert "--base IMAGE" in example("baseline")


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_equal_the_generators_output(name: str) -> None:
    written = (FOLDER / f"{name}.yml").read_text(encoding="utf-8")
    assert written == example(name), "run `make docs`"
    assert not re.search(r"/(home|root|work|tmp/(?!mast-up|:)|Users)\b", written.replace('"/tmp', '"')), (
        "no paths of this machine"
    )


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_are_valid_for_the_installed_compose(name: str) -> None:
    if not shutil.which("docker-compose"):
        pytest.skip("there is no docker-compose on this machine")
    path = FOLDER / f"{name}.yml"
    process = subprocess.run(
        ["docker-compose", "--file", str(path), "config", "--quiet"], capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr


#: Keys of a service that Compose 1.29 and 2 both accept: those of the Compose specification that the files use.
SERVICE = {
    *("build", "image", "user", "environment", "init", "read_only", "tmpfs", "cap_drop", "security_opt", "restart"),
    *(
        "cpus",
        "mem_limit",
        "pids_limit",
        "healthcheck",
        "container_name",
        "labels",
        "depends_on",
        "command",
        "networks",
    ),
    *("network_mode", "volumes", "working_dir", "stop_grace_period"),
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_have_only_keys_of_the_compose_specification(name: str) -> None:
    content = yaml.safe_load((FOLDER / f"{name}.yml").read_text(encoding="utf-8"))
    assert set(content) == {"x-node", "services", "networks", "volumes"}
    for service in content["services"].values():
        assert set(service) <= SERVICE
        assert "networks" not in service or "network_mode" not in service
        assert set(service.get("build", {})) <= {"context", "dockerfile", "target", "args"}
        needs = service.get("depends_on", [])
        conditions = {need["condition"] for need in needs.values()} if isinstance(needs, dict) else set()
        assert conditions <= {"service_started", "service_healthy"}
    assert all(set(network) <= {"internal", "labels", "name"} for network in content["networks"].values())
    assert all(set(volume) <= {"driver_opts", "labels", "name"} for volume in content["volumes"].values())


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_shipped_file_needs_nothing_from_outside(name: str) -> None:
    content = yaml.safe_load((FOLDER / f"{name}.yml").read_text(encoding="utf-8"))
    services = content["services"]
    nodes = set(services) - {"launcher", "certificates"}
    assert set(services["launcher"]["depends_on"]) == nodes, "it starts last"
    for service in services.values():
        assert "ports" not in service
        assert {volume.partition(":")[0] for volume in service.get("volumes", ())} <= set(content["volumes"])
    if EXAMPLES[name][1] != "open":
        assert all(services[node]["depends_on"]["certificates"] == {"condition": "service_healthy"} for node in nodes)
        for service in nodes | {"launcher"}:
            assert f"keys-{service}:/run/secrets:ro" in services[service]["volumes"]
            assert sum("keys-" in volume for volume in services[service]["volumes"]) == 1, "only its own"


def test_nodes_inside_a_complete_file_cannot_be_called_launcher() -> None:
    path, loaded = scenario.load("baseline", ["n_infrastructure=1"])
    loaded["nodes"] = {"launcher": dict(role="recorder", log="other.mcap")}
    with pytest.raises(ConfigurationError, match="'launcher': the launcher's name"):
        document.check_names(scenario.resolve(path, loaded, frames=2), inside=True)


def test_a_complete_file_is_refused_for_steps_that_need_docker() -> None:
    path, loaded = scenario.load("baseline", ["n_infrastructure=1"])
    loaded["faults"] = [dict(type="Pause", at=0.5, until=2.0, node="infra_1")]
    with pytest.raises(BackendError, match=r"pause of 'infra_1' .* no access to Docker"):
        inside.check_steps(scenario.resolve(path, loaded, frames=20, mode="realtime"))


def resolved(*chosen: str, name: str = "uncoordinated") -> Resolved:
    path, loaded = scenario.load(name, chosen)
    return scenario.resolve(path, loaded, frames=2, record=True)


def test_mobile_agents_and_their_interposers_are_on_the_wireless_network() -> None:
    services = document.document(resolved("n_mobile=1", name="realistic_network"), "r", image="i")["services"]
    on = {name: service["networks"] for name, service in services.items()}
    assert on["router"] == ["launcher", "wired", "wireless"]
    assert [name for name, networks in on.items() if networks == ["wireless"]] == [
        "ego",
        "mobile_1",
        "link_ego",
        "link_mobile_1",
    ]
    assert all(networks == ["wired"] for name, networks in on.items() if name.startswith(("infra", "link_infra", "cc")))


def test_every_node_gets_only_its_own_credentials() -> None:
    content = document.document(resolved(), "r", image="i", secure="acl")
    for name, service in content["services"].items():
        if name != "router":
            assert {secret["source"] for secret in service["secrets"]} == {f"{name}_{file}" for file in CREDENTIALS}
            assert {secret["target"] for secret in service["secrets"]} == CREDENTIALS
    assert content["secrets"]["ego_key.pem"] == {"file": "./credentials/ego/key.pem"}


def test_on_an_open_mesh_no_node_has_credentials() -> None:
    content = document.document(resolved(), "r", image="i")
    assert "secrets" not in content
    assert not any("secrets" in service for service in content["services"].values())


def test_a_node_with_the_name_of_the_router_is_refused() -> None:
    path, loaded = scenario.load("baseline", ["n_infrastructure=1"])
    loaded["nodes"] = {"router": dict(role="recorder", log="other.mcap")}
    with pytest.raises(ConfigurationError, match="'router': the router's name"):
        document.check_names(scenario.resolve(path, loaded, frames=2))
