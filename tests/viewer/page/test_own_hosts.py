"""Names of this computer, and the way to its loopback address from another one."""

from __future__ import annotations

from mast_zenoh.show.page.live_server import is_own_host, tunnel


def test_only_names_of_this_computer_are_its_own() -> None:
    for host in ("127.0.0.1", "localhost:8000", "LOCALHOST", "LocalHost:8000"):
        assert is_own_host(host)
    for host in ("", "attacker.example", "attacker.example:8000", "127.0.0.1.example"):
        assert not is_own_host(host)


def test_a_tunnel_leads_to_the_port_of_an_address() -> None:
    assert tunnel("ws://127.0.0.1:8765").startswith("ssh -L 8765:127.0.0.1:8765 ")
