"""Hosts as namespaces: link behaviour, isolation and cleanup."""

import os
import shutil
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import pytest
from launched import Launched, eventually
from namespaced import Echo, leftovers_of, machine_network, require

from mast_zenoh import scenario
from mast_zenoh.errors import BackendError
from mast_zenoh.faults import network
from mast_zenoh.launch import run as launcher
from mast_zenoh.launch.netns import namespaces
from mast_zenoh.launch.netns.hosts import CENTRE, Hosts
from mast_zenoh.launch.netns.namespaces import NAMESPACES, own_prefix, sweep
from mast_zenoh.mesh.session import open_client, open_router

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]


def hosts(tmp_path: Path, *faults: dict, rate: float = 1.0, **west: object) -> Hosts:
    """Hosts west (node `a`) and east (node `b`); `c` is at the centre."""
    spec = {"west": {"nodes": ["a"], **west}, "east": {"nodes": ["b"]}}
    located_faults = [
        (f"faults[{index}]", {"at": 0.0, "hosts": ["west"], **fault}) for index, fault in enumerate(faults)
    ]
    return Hosts(network.resolve(spec, located_faults, ["a", "b", "c"], mode="realtime", place="test"), rate, tmp_path)


def wait_for_steps(namespaces: Hosts, steps: int) -> None:
    """Start the scene clock, and wait until this many steps are done."""
    namespaces.begin()
    eventually(lambda: namespaces.problem() or len(namespaces.done) == steps, f"{steps} steps", seconds=20.0)
    assert namespaces.problem() is None


def test_each_host_reaches_only_the_centre(tmp_path: Path) -> None:
    require()
    before = machine_network() if shutil.which("nft") else None
    with hosts(tmp_path) as namespaces, Echo(namespaces.command("c")), Echo(namespaces.command("b")):
        assert len(leftovers_of(os.getpid())) == 4, "three namespaces, and a folder for the router's socket"
        for node in ("a", "b", "c"):
            assert len(Echo.ask(namespaces.command(node), CENTRE, 3)) == 3
        east = subprocess.run(
            [*namespaces.command("b"), "hostname", "-I"], capture_output=True, text=True
        ).stdout.split()[0]
        with pytest.raises(subprocess.CalledProcessError):
            Echo.ask(namespaces.command("a"), east, 1)
        assert before is None or machine_network() == before
    assert leftovers_of(os.getpid()) == []
    assert before is None or machine_network() == before


def test_a_partition_blocks_everything_until_it_heals(tmp_path: Path) -> None:
    require("partition")
    with hosts(tmp_path, {"type": "HostPartition"}) as namespaces, Echo(namespaces.command("c")):
        wait_for_steps(namespaces, 1)
        assert Echo.ask(namespaces.command("a"), CENTRE, 5, 0.05) == []
        assert len(Echo.ask(namespaces.command("b"), CENTRE, 5)) == 5, "other nodes are not affected"
        namespaces.heal()
        assert len(Echo.ask(namespaces.command("a"), CENTRE, 5)) == 5


def test_packets_are_lost_with_the_configured_probability_in_each_direction(tmp_path: Path) -> None:
    require("loss")
    with hosts(tmp_path, {"type": "HostLoss", "probability": 0.2}) as namespaces, Echo(namespaces.command("c")):
        wait_for_steps(namespaces, 1)
        n_returned = len(Echo.ask(namespaces.command("a"), CENTRE, 400, 0.01))
    # 0.8² of 400 is 256; binomial, σ = 9.6. A packet that took longer than 10 ms on a busy machine counts as lost.
    assert 400 * 0.64 - 80 < n_returned < 400 * 0.64 + 5 * 9.6


def test_a_bandwidth_limit_is_enforced(tmp_path: Path) -> None:
    require("bandwidth")
    with hosts(tmp_path, {"type": "HostBandwidth", "bits_per_s": 100e3}) as namespaces, Echo(namespaces.command("c")):
        wait_for_steps(namespaces, 1)
        # A packet is 1242 bytes with headers and the bucket holds 4000; the remaining packets take 1.27 s.
        assert sum(Echo.ask(namespaces.command("a"), CENTRE, 16, 2.0, size=1200)) > 1200.0
        namespaces.heal()
        assert min(Echo.ask(namespaces.command("a"), CENTRE, 5, size=1200)) < 50.0


@pytest.mark.parametrize("by", ["relay", "netem"])
def test_a_delayed_link_has_the_configured_delay_in_each_direction(tmp_path: Path, by: str) -> None:
    if by == "relay":
        require("relay")
    elif reason := missing_capability("netem"):
        pytest.skip(reason)
    delay = {"type": "HostDelay", "delay_ms": 15.0}
    with hosts(tmp_path, delay, delay_ms=20.0, delay_by=by) as namespaces, Echo(namespaces.command("c")):
        assert 40.0 <= min(Echo.ask(namespaces.command("a"), CENTRE, 20)) < 50.0
        assert min(Echo.ask(namespaces.command("b"), CENTRE, 20)) < 10.0
        wait_for_steps(namespaces, 1)
        assert 70.0 <= min(Echo.ask(namespaces.command("a"), CENTRE, 20)) < 80.0
        namespaces.heal()
        assert 40.0 <= min(Echo.ask(namespaces.command("a"), CENTRE, 20)) < 50.0


def test_a_delayed_link_can_also_be_partitioned_and_limited(tmp_path: Path) -> None:
    require("relay", "partition", "bandwidth")
    limit = {"type": "HostBandwidth", "bits_per_s": 100e3}
    cut = {"type": "HostPartition", "at": 0.1}
    with hosts(tmp_path, limit, cut, delay_ms=20.0, delay_by="relay") as namespaces, Echo(namespaces.command("c")):
        wait_for_steps(namespaces, 2)
        assert Echo.ask(namespaces.command("a"), CENTRE, 3, 0.2) == []
        namespaces.heal()
        assert len(Echo.ask(namespaces.command("a"), CENTRE, 3)) == 3


def test_scene_time_advances_at_the_configured_rate(tmp_path: Path) -> None:
    require("partition")
    with hosts(tmp_path, {"type": "HostPartition", "at": 600.0, "until": 1200.0}, rate=6000.0) as namespaces:
        wait_for_steps(namespaces, 2)
        assert [step["at_s"] for step in namespaces.done] == [600.0, 1200.0]


def test_a_failed_relay_is_reported(tmp_path: Path) -> None:
    require("relay")
    with hosts(tmp_path, delay_ms=5.0, delay_by="relay") as namespaces:
        assert namespaces.problem() is None
        relay = next(process for process in namespaces._processes if process.name == "relay_west")
        relay._process.kill()
        eventually(namespaces.problem, "the failure is reported", seconds=5.0)
        assert "relay_west has ended" in str(namespaces.problem())
    assert leftovers_of(os.getpid()) == []


def test_remnants_of_a_killed_launcher_are_removed_at_the_next_start(tmp_path: Path) -> None:
    require()
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    leftover, own = f"mast-{ended.pid}-1-0-centre", f"{own_prefix()}centre"
    reused_pid = f"mast-{os.getpid()}-1-0-centre"  # a reused pid: this process was not started at tick 1
    foreign = f"not-mast-{ended.pid}"
    for name in (leftover, own, reused_pid, foreign):
        subprocess.run(["ip", "netns", "add", name], check=True)
    folder = Path(tempfile.gettempdir()) / f"mast-{ended.pid}-1-0-abc"
    folder.mkdir()
    try:
        sweep()
        assert not folder.exists()
        assert {path.name for path in NAMESPACES.iterdir()} & {leftover, own, reused_pid, foreign} == {own, foreign}
    finally:
        for name in (own, foreign):
            subprocess.run(["ip", "netns", "del", name], check=True)


def missing_capability(need: str) -> str | None:
    """Why this machine lacks a capability; None if it has it."""
    try:
        namespaces.delays_by({need: ["west"]})
    except BackendError as error:
        return str(error)
    return None


def test_missing_tools_are_named_with_their_purpose_and_package(tmp_path, monkeypatch) -> None:
    require("relay")
    (tmp_path / "bin").mkdir()
    for program in ("ip", "tc"):
        (tmp_path / "bin" / program).symlink_to(shutil.which(program))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    assert missing_capability("partition") == (
        "partition of west: nft is missing: install nftables, and a kernel with nf_tables"
    )
    monkeypatch.setattr(namespaces, "_TUN", str(tmp_path / "tun"))
    assert f"relay of west: {tmp_path}/tun is missing: load the kernel module tun" in str(missing_capability("relay"))
    (tmp_path / "bin" / "tc").unlink()
    assert str(missing_capability("bandwidth")).startswith("bandwidth of west: tc is missing: install iproute2")
    (tmp_path / "bin" / "ip").unlink()
    assert missing_capability("partition") == "partition of west: no program `ip` on this machine: install iproute2"
    assert leftovers_of(os.getpid()) == []


def test_a_run_that_this_machine_cannot_support_is_refused_before_any_process_starts(
    launch, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    require()
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin" / "ip").symlink_to(shutil.which("ip"))
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    run: Launched = launch("two_hosts", "--frames", "20")
    output = run.ended(25)
    assert "partition of west: nft is missing: install nftables" in " ".join(output.split())
    assert run.record()["nodes"] == {}
    assert leftovers_of(run.process.pid) == []


def test_a_run_in_one_process_refuses_host_faults(tmp_path: Path) -> None:
    path, loaded = scenario.load("two_hosts")
    run_result = launcher.run(scenario.resolve(path, loaded, frames=5), tmp_path / "run", runtime="inproc")
    assert isinstance(run_result.error, BackendError)
    assert "one process has no network" in str(run_result.error)


def test_a_router_drops_an_unresponsive_link_before_its_lease_expires() -> None:
    """Otherwise closing blocks while sockets wait for acknowledgements."""
    router, endpoint = open_router()
    with router, open_client(endpoint):
        port = int(endpoint.rpartition(":")[2])
        user_timeout_ms = {}
        for fd in os.listdir("/proc/self/fd"):
            with suppress(OSError), socket.fromfd(int(fd), socket.AF_INET, socket.SOCK_STREAM) as ours:
                if ours.getsockname()[1:2] == (port,):  # the listening socket, and our end of the client's link
                    user_timeout_ms[fd] = ours.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT)
    assert len(user_timeout_ms) == 2
    assert set(user_timeout_ms.values()) == {1500}
