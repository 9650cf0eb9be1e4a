"""Generated compose files: readable, valid for Docker, reproducible."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml
from compose_examples import EXAMPLES, example
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from mast_zenoh import scenario
from mast_zenoh.cli.app import app
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy import documents
from mast_zenoh.deploy.compose_inside import check_steps
from mast_zenoh.deploy.documents import on_one_line
from mast_zenoh.deploy.engine import NUMERIC_VARIABLES
from mast_zenoh.errors import BackendError, ConfigurationError

FOLDER = Path(__file__).parents[2] / "deploy" / "compose"
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

#: Keys of a service that Compose 1.29 and 2 both accept: those of the Compose specification that the files use.
SERVICE = {
    *("build", "image", "user", "environment", "init", "read_only", "tmpfs", "cap_drop", "security_opt", "restart"),
    *("cpus", "mem_limit", "pids_limit", "healthcheck", "container_name", "labels", "depends_on", "command"),
    *("networks", "network_mode", "volumes", "working_dir", "stop_grace_period"),
}


@given(st.dictionaries(KEYS, NESTED, max_size=4))
def test_dumped_values_are_read_back_unchanged(content: dict[str, Any]) -> None:
    def doubled(value: Any) -> Any:
        if isinstance(value, dict):
            return {doubled(key): doubled(item) for key, item in value.items()}
        if isinstance(value, list):
            return list(map(doubled, value))
        return value.replace("$", "$$") if isinstance(value, str) else value

    assert yaml.safe_load(on_one_line(content)) == doubled(content)


def test_a_name_adds_no_line_to_the_file() -> None:
    scenario_ = resolve("baseline", "n_infrastructure=1")
    for launcher in (documents.Launcher("baseline"), None):

        def written(name: str, launcher: documents.Launcher | None = launcher) -> str:
            return documents.compose_text(replace(scenario_, name=name), name, image="mast", launcher=launcher)

        plain = written("plain")
        for newline in ("\n", "\r", "\x85", "\u2028", "\u2029"):
            hostile = written(f"plain{newline}services: {{}}")
            assert len(hostile.splitlines()) == len(plain.splitlines())
            assert yaml.safe_load(hostile).keys() == yaml.safe_load(plain).keys()


def test_a_name_of_a_run_that_is_not_one_is_refused() -> None:
    result = CliRunner().invoke(app, ["deploy", "write", "baseline", "--run", "a\nservices: {}"])
    assert isinstance(result.exception, ConfigurationError)
    assert "{}', expected" in str(result.exception)


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_shipped_file_is_the_generators_output_valid_and_needs_nothing_from_outside(name: str) -> None:
    path = FOLDER / f"{name}.yml"
    written = path.read_text(encoding="utf-8")
    assert written == example(name), "run `make docs`"
    assert "deploy image --launcher`" in written
    assert "--base IMAGE" in written
    paths = re.sub(r"/tmp(/mast-up|:)", "", written)
    assert not re.search(r"/(home|root|work|tmp|Users)\b", paths), "no paths of this machine"
    content = yaml.safe_load(written)
    assert set(content) == {"x-node", "services", "networks", "volumes"}
    handed_on = content["x-node"]["environment"]
    assert handed_on == dict.fromkeys(NUMERIC_VARIABLES), "without a value: Compose takes that of its own environment"
    services = content["services"]
    nodes = set(services) - {"launcher", "certificates"}
    assert set(services["launcher"]["depends_on"]) == nodes, "it starts last"
    for service in services.values():
        assert set(service) <= SERVICE
        assert service["cap_drop"] == ["ALL"], "the settings of all nodes are merged in"
        assert "networks" not in service or "network_mode" not in service
        assert set(service.get("build", {})) <= {"context", "dockerfile", "target", "args"}
        needs = service.get("depends_on", [])
        conditions = {need["condition"] for need in needs.values()} if isinstance(needs, dict) else set()
        assert conditions <= {"service_started", "service_healthy"}
        assert {volume.partition(":")[0] for volume in service.get("volumes", ())} <= set(content["volumes"])
    assert all(set(network) <= {"internal", "labels", "name"} for network in content["networks"].values())
    assert all(set(volume) <= {"driver_opts", "labels", "name"} for volume in content["volumes"].values())
    if EXAMPLES[name][1] != "open":
        assert all(services[node]["depends_on"]["certificates"] == {"condition": "service_healthy"} for node in nodes)
        for service in nodes | {"launcher"}:
            keys = [volume for volume in services[service]["volumes"] if "keys-" in volume]
            assert keys == [f"keys-{service}:/run/secrets:ro"], "only its own"
    if shutil.which("docker-compose"):
        words = ["docker-compose", "--file", str(path), "config", "--quiet"]
        process = subprocess.run(words, capture_output=True, text=True, check=False)
        assert process.returncode == 0, process.stderr


def resolve(name: str = "uncoordinated", *chosen: str, **more: Any) -> Resolved:
    path, loaded = scenario.load(name, chosen)
    options = {key: more.pop(key) for key in ("mode", "frames", "rate") if key in more}
    return scenario.resolve(path, loaded | more, record=True, **({"frames": 2} | options))


def compose(*run: Any, **options: Any) -> dict[str, Any]:
    content: dict[str, Any] = yaml.safe_load(documents.compose_text(*run, **options))
    return content


def test_a_node_cannot_have_the_name_of_another_service() -> None:
    for name in ("launcher", "router"):
        nodes = {name: dict(role="recorder", log="other.mcap")}
        with pytest.raises(ConfigurationError, match=f"'{name}': the {name}'s name"):
            documents.check_names(resolve("baseline", "n_infrastructure=1", nodes=nodes), inside=True)


def test_a_complete_file_is_refused_for_steps_that_need_docker() -> None:
    faults = [dict(type="Pause", at=0.5, until=2.0, node="infra_1")]
    with pytest.raises(BackendError, match=r"'infra_1'.*access.*Docker"):
        check_steps(resolve("baseline", "n_infrastructure=1", faults=faults, frames=20, mode="realtime"))


def test_mobile_agents_and_their_interposers_are_on_the_wireless_network() -> None:
    services = compose(resolve("realistic_network", "n_mobile=1"), "r", image="i")["services"]
    on = {name: service["networks"] for name, service in services.items()}
    assert on["router"] == ["launcher", "wired", "wireless"]
    wireless = [name for name, networks in on.items() if networks == ["wireless"]]
    assert wireless == ["ego", "mobile_1", "link_ego", "link_mobile_1"]
    assert all(networks == ["wired"] for name, networks in on.items() if name.startswith(("infra", "link_infra", "cc")))


def test_every_node_gets_only_its_own_credentials() -> None:
    content = compose(resolve(), "r", image="i", secure="acl")
    for name, service in content["services"].items():
        names = {"router.json"} if name == "router" else CREDENTIALS
        assert {secret["source"] for secret in service["secrets"]} == {f"{name}_{file}" for file in names}
        assert {secret["target"] for secret in service["secrets"]} == names
    assert content["secrets"]["ego_key.pem"] == {"file": "./credentials/ego/key.pem"}
    opened = compose(resolve(), "r", image="i")
    assert "secrets" not in opened
    assert not any("secrets" in service for service in opened["services"].values())


def test_a_disconnected_node_waits_longer_for_the_launcher() -> None:
    faults = [dict(type="Unplug", at=0.5, until=4.5, node="infra_1")]
    unplugged = resolve("baseline", "n_infrastructure=1", faults=faults, frames=60, mode="realtime", rate=0.5)
    services = compose(unplugged, "a-run", image="any", patience_s=10.0)["services"]
    waits = {name: service["command"][-1] for name, service in services.items()}
    assert waits.pop("infra_1") == "18", "4 s of scene time at half speed"
    assert set(waits.values()) == {"10"}
