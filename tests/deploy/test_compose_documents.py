"""Generated compose files: readable, valid for Compose, reproducible."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from mast_zenoh import scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.deploy.compose import document
from mast_zenoh.deploy.compose.examples import EXAMPLES, example
from mast_zenoh.deploy.yamltext import dump
from mast_zenoh.errors import ConfigurationError

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "deploy" / "compose"

CREDENTIALS = {"ca.pem", "certificate.pem", "key.pem", "control.json"}

TEXT = st.text(st.characters(min_codepoint=32, max_codepoint=0x2FFF, exclude_categories=["Cc", "Cf", "Cs", "Zl", "Zp"]))
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
