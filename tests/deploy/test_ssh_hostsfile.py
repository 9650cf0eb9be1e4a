"""hosts.toml: strict reading, errors with paths, and placement of nodes."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mast_zenoh.config.bundle import ROOT
from mast_zenoh.config.resolved import NodeSpec
from mast_zenoh.deploy.ssh.hostsfile import LAUNCHER, HostsFile, parse, read
from mast_zenoh.errors import ConfigurationError

TWO = '[hosts.alpha]\naddress = "a"\n[hosts.beta]\naddress = "b"\n'


def spec(role: str) -> NodeSpec:
    return NodeSpec(role, f"{role}.py", role, {}, "fail")


NODES = {name: spec(name) for name in ("simulator", "ego", "infra_1", "infra_2", "broker")}
NODES |= dict.fromkeys(("ego", "infra_1", "infra_2"), spec("agent"))


def test_the_example_hosts_file_places_every_node() -> None:
    hosts = read(ROOT / "deploy" / "hosts.toml")
    assert set(hosts.placed(NODES)) == set(NODES)


def test_defaults_fill_in_missing_settings_of_a_host() -> None:
    hosts = parse('[defaults]\nuser = "mast"\nport = 2222\n' + TWO + "port = 22\n", "h.toml")
    assert (hosts.hosts["alpha"].user, hosts.hosts["alpha"].port) == ("mast", 2222)
    assert (hosts.hosts["beta"].user, hosts.hosts["beta"].port) == ("mast", 22)
    assert hosts.router.on == LAUNCHER


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "h.toml: hosts: found"),
        ("hosts = 1", "h.toml: hosts: found"),
        ("[hosts]\nalpha = 1", "h.toml: hosts.alpha: found"),
        ("[hosts.alpha]", "h.toml: hosts.alpha: SshHost"),
        ("[hosts.launcher]\naddress = 'x'", "hosts.launcher: SshHost: expected"),
        ("[hosts.'a/b']\naddress = 'x'", "hosts.a/b: SshHost: expected"),
        (TWO + "adress = 'x'", "h.toml: hosts.beta.adress: SshHost"),
        (TWO + "port = 0", "hosts.beta: SshHost: port"),
        (TWO + "port = '22'", "hosts.beta.port: found '22'"),
        (TWO + "port = true", "hosts.beta.port: found True"),
        (TWO + "spread = 1", "hosts.beta.spread: found 1"),
        (TWO + "nodes = 'ego'", "hosts.beta.nodes: found 'ego'"),
        (TWO + "roles = [1]", "hosts.beta.roles[0]: found 1"),
        (TWO + "folder = ''", "hosts.beta: SshHost: folder"),
        (TWO + "[defaults]\nusr = 'x'", "h.toml: defaults.usr: SshAddress"),
        (TWO + "[defaults]\naddress = 'x'", "h.toml: defaults.address: SshAddress"),
        (TWO + "[router]\non = 'alhpa'", "h.toml: router.on: no"),
        (TWO + "[router]\nport = 70000", "router: Router: port"),
        (TWO + "[router]\non = 'beta'\nport = 0", "router: Router: port"),
        ("patience_s = 0\n" + TWO, "h.toml: patience_s: found"),
        ("patience_s = nan\n" + TWO, "h.toml: patience_s: found"),
        ("[hosts", "h.toml: "),
    ],
)
def test_an_invalid_file_is_refused_with_the_location_of_the_fault(text: str, expected: str) -> None:
    with pytest.raises(ConfigurationError) as refused:
        parse(text, "h.toml")
    assert expected in str(refused.value)


@given(st.text(max_size=200) | st.text(alphabet='[]hosts.="1\n{}', max_size=60))
def test_any_text_is_read_or_refused(text: str) -> None:
    error_message = "h.toml: "
    try:
        assert isinstance(parse(text, "h.toml"), HostsFile)
    except ConfigurationError as error:
        error_message = str(error)
    assert error_message.startswith("h.toml: ")


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"missing\.toml: No.*file"):
        read(tmp_path / "missing.toml")
    (tmp_path / "latin.toml").write_bytes(b"# \xff")
    with pytest.raises(ConfigurationError, match=r"latin\.toml.*not UTF-8"):
        read(tmp_path / "latin.toml")


def placed(*of: str) -> dict[str, str]:
    text = "".join(f'[hosts.h{index}]\naddress = "a"\n{more}\n' for index, more in enumerate(of))
    return parse(text, "h.toml").placed(NODES)


def test_nodes_are_placed_by_name_then_by_role_then_in_turn() -> None:
    assert placed("", "") == {"simulator": "h0", "ego": "h1", "infra_1": "h0", "infra_2": "h1", "broker": "h0"}
    assert placed('nodes = ["ego"]', "") == {name: "h0" if name == "ego" else "h1" for name in NODES}
    by_role = placed('roles = ["agent"]', 'roles = ["agent"]', 'nodes = ["infra_1"]\nspread = true')
    assert by_role == {"simulator": "h2", "ego": "h0", "infra_1": "h2", "infra_2": "h1", "broker": "h2"}
    everywhere = placed('nodes = ["infra_*"]', 'roles = ["broker"]')
    assert placed('nodes = ["mobile_*"]\nroles = ["recorder"]') == dict.fromkeys(NODES, "h0"), "names an unknown node"
    assert everywhere == {"simulator": "h0", "ego": "h1", "infra_1": "h0", "infra_2": "h0", "broker": "h1"}


def test_a_placement_that_contradicts_the_scenario_is_refused() -> None:
    for of, expected in (
        (('nodes = ["infra_11"]',), "h.toml: hosts.h0.nodes[0]: no node 'infra_11'; did you mean 'infra_1'?"),
        (('roles = ["agnt"]',), "h.toml: hosts.h0.roles[0]: there is no role 'agnt'; did you mean 'agent'?"),
        (('nodes = ["ego"]', 'nodes = ["e*"]'), "h.toml: hosts.h1.nodes[0]: ego is already on h0"),
    ):
        with pytest.raises(ConfigurationError) as refused:
            placed(*of)
        assert expected in str(refused.value)


@given(st.lists(st.sampled_from(["", "spread = true", 'roles = ["agent"]', 'nodes = ["ego"]']), min_size=1, max_size=5))
def test_every_node_has_exactly_one_host(of: list[str]) -> None:
    if of.count('nodes = ["ego"]') < 2:
        assert set(placed(*of)) == set(NODES)
