"""Viewers and foreign clients do not hold up a lock-step run, even when they are suspended."""

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import zenoh
from equal_runs import assert_equal, run_alone
from launched import MAST, Launched, eventually

from mast_zenoh.errors import NotRunning
from mast_zenoh.mesh import session
from mast_zenoh.mesh.session import open_client, open_router

pytestmark = [pytest.mark.heavy, pytest.mark.mesh]

_LISTENS = "received = session.declare_subscriber('**', zenoh.handlers.RingChannel(1)); print('there', flush=True)"
#: A viewer's own session, and one of a client with Zenoh's own settings, at the router of the first argument.
_VIEWER = f"""
import sys, zenoh
from mast_zenoh.mesh import hosting
session = hosting.join(sys.argv[1], None, observer=True)
{_LISTENS}
sys.stdin.read()
"""
_CLIENT = """
import sys, time, zenoh
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("scouting/multicast/enabled", "false")
config.insert_json5("connect/endpoints", f'["{sys.argv[1]}"]')
session = zenoh.open(config)
"""
#: A client that takes a message every 0.2 s, one that claims to be the node of the second argument, then listens, and
#: one that also suspends itself as soon as it has received a message.
_SUSPENDS = "import os, signal; received.recv(); os.kill(os.getpid(), signal.SIGSTOP)"
_TRICKLE = f"""{_CLIENT}
slow = zenoh.handlers.Callback(lambda _: time.sleep(0.2), indirect=False)
received = session.declare_subscriber('**', slow)
print('there', flush=True)
sys.stdin.read()
"""
_CLAIMS = f"""{_CLIENT}
token = session.liveliness().declare_token(sys.argv[2])
{_LISTENS}
"""
_CLAIMANT = f"{_CLAIMS}sys.stdin.read()"
_SUSPENDED_CLAIMANT = f"{_CLAIMS}{_SUSPENDS}"


@contextmanager
def watching(program: str, endpoint: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A process that subscribes to everything."""
    command = [sys.executable, "-c", program, endpoint, *arguments]
    with subprocess.Popen(command, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as watcher:
        try:
            assert watcher.stdout is not None
            assert watcher.stdout.readline() == "there\n"
            yield watcher
        finally:
            watcher.kill()


def test_a_node_gets_every_message_while_a_viewer_is_suspended() -> None:
    router, endpoint = open_router(patient=True)
    count = 2000
    received: list[zenoh.Sample] = []
    with router, open_client(endpoint, patient=True) as node, open_client(endpoint, patient=True) as sender:
        subscriber = node.declare_subscriber("data", zenoh.handlers.Callback(received.append, indirect=False))
        publisher = sender.declare_publisher("data", congestion_control=zenoh.CongestionControl.BLOCK)
        with watching(_VIEWER, endpoint) as viewer:
            eventually(lambda: publisher.matching_status, "the subscribers are known")
            viewer.send_signal(signal.SIGSTOP)
            for _ in range(count):  # 64 MB: more than all buffers hold
                publisher.put(bytes(32_000))
            eventually(lambda: len(received) == count, "the node has everything", seconds=20.0)
        subscriber.undeclare()


#: Some 25 frames fill all buffers on the way to a client that does not read.
_RUN = ("coordinated", "--set", "attack_start_s=0.5", "--set", "n_infrastructure=2", "--frames", "80")


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of `_RUN` that nobody watches."""
    out = tmp_path_factory.mktemp("undisturbed") / "run"
    return run_alone(out, _RUN[0], *_RUN[2:6:2], frames=int(_RUN[-1]), mode="lockstep", record=True)


@pytest.fixture
def begun(launch: Callable[..., Launched]) -> tuple[Launched, str]:
    """The same run on a mesh as soon as its router is there, and its endpoint."""
    run = launch(*_RUN, "--mode", "lockstep")
    return run, run.until(lambda: run.record().get("endpoint"), "the run has a router")


def disconnected(run: Launched, undisturbed: Path) -> str:
    """The only sentence on a client that was disconnected, after the run has ended like the undisturbed one."""
    run.ended()
    assert_equal(undisturbed, run.out)
    assert not run.record()["churn"]
    (sentence,) = run.record()["disconnected"]
    assert sentence in {notice["text"] for notice in run.record()["notices"]}
    return str(sentence)


@contextmanager
def watched(run: Launched, endpoint: str, program: str, *arguments: str) -> Iterator[None]:
    """A run in progress with a client: no frame is played until the client is there."""
    run.until(run.recorded, "frames are played")
    simulator = run.record()["nodes"]["simulator"]["pid"]
    os.kill(simulator, signal.SIGSTOP)
    with watching(program, endpoint, *arguments):
        os.kill(simulator, signal.SIGCONT)
        yield


@pytest.mark.parametrize("program", [_TRICKLE, _SUSPENDED_CLAIMANT], ids=["slow", "suspended, claims to be a node"])
def test_a_run_goes_on_without_a_client_that_does_not_read_in_time_and_names_it(begun, undisturbed, program) -> None:
    run, endpoint = begun
    with watched(run, endpoint, program, f"mast/{run.record()['id']}/alive/infra_1"):
        assert "did not read in time what it subscribed to" in disconnected(run, undisturbed)


def test_a_run_begins_with_a_node_whose_name_was_claimed_before_it_was_there(begun, undisturbed) -> None:
    run, endpoint = begun
    with watching(_CLAIMANT, endpoint, f"mast/{run.record()['id']}/alive/infra_1"):
        run.ended()
    assert_equal(undisturbed, run.out)
    assert not run.record()["churn"]


def test_a_viewer_gives_up_on_a_listener_that_never_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "_OBSERVER_S", 0.5)
    monkeypatch.setattr(session, "_OBSERVER_TRY_MS", 500)
    answers = pytest.raises(NotRunning, match=r"no Zenoh router answered within 0\.5 s")
    with socket.create_server(("127.0.0.1", 0)) as silent, answers as raised:
        session.open_observer(f"tcp/127.0.0.1:{silent.getsockname()[1]}")
    assert raised.value.exit_code == 26


def test_a_viewer_gives_up_on_a_router_without_a_run(tmp_path: Path) -> None:
    router, endpoint = open_router()
    with router:
        done = subprocess.run([*MAST, "view", endpoint], capture_output=True, text=True, cwd=tmp_path, timeout=60)
    assert done.returncode == 26, done.stderr
    assert "no run answers" in " ".join(done.stderr.split())
    assert "Traceback" not in done.stderr
