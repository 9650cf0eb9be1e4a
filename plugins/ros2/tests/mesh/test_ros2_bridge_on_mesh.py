"""A running run in ROS 2: a foreign client receives every frame of real time, on secure meshes too, and may stall."""

import re
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import psutil
import pytest
from launched import MAST, Launched, alive, eventually
from mast_ros2 import type_store
from ros2_client import ForeignClient, expected_messages, ros2_router

from mast_zenoh.mesh.security.authority import Authority
from mast_zenoh.mesh.security.credentials import ROUTER
from mast_zenoh.mesh.security.levels import router_settings
from mast_zenoh.runs.recorded import open_recorded

pytestmark = [pytest.mark.mesh, pytest.mark.long]

TOPICS: Mapping[str, str] = {
    "/clock": type_store.CLOCK,
    "/tf": type_store.TF_MESSAGE,
    "/tf_static": type_store.TF_MESSAGE,
    "/agent/ego/odometry": type_store.ODOMETRY,
    "/agent/ego/tracks": type_store.DETECTIONS,
    "/agent/infra_1/tracks/received/tracked_objects": type_store.TRACKED_OBJECTS,
    "/cc/picture": type_store.DETECTIONS,
    "/cc/picture/markers": type_store.MARKER_ARRAY,
    "/cc/picture/predicted_objects": type_store.PREDICTED_OBJECTS,
    "/scene/truth/tracked_objects": type_store.TRACKED_OBJECTS,
}
#: Few agents: what a bridge does is the same with more.
COORDINATED = ("coordinated", "--set", "n_infrastructure=2", "--set", "n_adversaries=1")
#: 20 frames a second.
REAL_TIME = (*COORDINATED, "--mode", "realtime", "--rate", "2")
#: A router that waits longer for a peer than the peer stalls in these tests.
PATIENT = {"transport/link/tx/queue/congestion_control/block/wait_before_close": 60_000_000}

Launch = Callable[..., Launched]


@pytest.fixture
def client_of(tmp_path: Path) -> Any:
    """Starts foreign clients that subscribe to TOPICS."""
    with ExitStack() as stack:
        yield lambda router, *overrides: stack.enter_context(
            ForeignClient(router, TOPICS, tmp_path / "received.json", overrides=overrides)
        )


def settings_of(router: str, **tls: object) -> list[str]:
    words = {"ros2.router": router} | ({"ros2.tls": {name: str(path) for name, path in tls.items()}} if tls else {})
    return [word for key, value in words.items() for word in ("--set", f"{key}={value}")]


def without_colours(markers: list[Any]) -> list[Any]:
    return [[{**marker, "color": None} for marker in message["markers"]] for message in markers]


def assert_recorded(client: ForeignClient, folder: Path, frames: int) -> None:
    """What a client has received is what the recording of a run says, frame by frame."""
    expected = expected_messages(open_recorded(folder), TOPICS)
    counts = {topic: frames if topic != "/tf_static" else 1 for topic in TOPICS}
    assert {topic: len(messages) for topic, messages in expected.items()} == counts
    eventually(lambda: client.counts() == counts, f"every message, of {counts}", 20)
    received = client.messages()
    for topic in TOPICS:
        if topic.endswith("/markers"):  # colours need time
            assert without_colours(received[topic]) == without_colours(expected[topic])
        else:
            assert received[topic] == expected[topic], topic


def sent(output: str) -> int:
    """Number of frames that a bridge has sent; nothing is missing but outcomes."""
    warnings = [line for line in output.splitlines() if line.startswith("warning: ")]
    assert all("were not evaluated in time" in line for line in warnings), output
    match = re.search(r"^sent: (\d+) frames$|^sent: (\d+) of \d+ frames: in lock-step", output, re.MULTILINE)
    assert match, output
    return int(match[1] or match[2])


@pytest.mark.heavy
def test_a_foreign_client_receives_every_frame_of_a_run_in_real_time_also_if_it_stalls(launch, client_of) -> None:
    with ros2_router(PATIENT) as router:
        client = client_of(router)
        run = launch(*REAL_TIME, "--frames", "60", "--rate", "1", *settings_of(router))
        eventually(lambda: client.counts()["/clock"] > 5, "the first frames")
        client.stall()
        run.until(lambda: run.record().get("status") not in (None, "running"), "the end of the run")
        client.resume()
        assert sent(run.ended()) == 60
        assert_recorded(client, run.out, 60)


@pytest.mark.heavy
def test_a_client_that_never_reads_again_is_dropped_and_others_receive_everything(launch, client_of, tmp_path) -> None:
    short = {"transport/link/tx/queue/congestion_control/block/wait_before_close": 1_000_000}
    tiny = "transport/link/tcp/so_rcvbuf=4096"
    with (
        ros2_router(short) as router,
        ForeignClient(router, TOPICS, tmp_path / "stalled.json", overrides=[tiny]) as bad,
    ):
        client = client_of(router)
        run = launch(*REAL_TIME, "--frames", "60", *settings_of(router))
        eventually(lambda: bad.counts()["/clock"] > 5, "the first frames")
        bad.stall()
        assert sent(run.ended()) == 60
        assert_recorded(client, run.out, 60)


@pytest.mark.heavy
def test_secure_meshes_and_routers_that_demand_certificates_are_bridged(launch, client_of, tmp_path) -> None:
    authority = Authority("ros")
    own = authority.issue("bridge").write(tmp_path / "bridge")
    files = {"ca": own / "ca.pem", "certificate": own / "certificate.pem", "key": own / "key.pem"}
    with ros2_router(router_settings("mtls", authority.issue(ROUTER, ["127.0.0.1"])), "tls") as router:
        names = {"ca": "root_ca_certificate", "certificate": "connect_certificate", "key": "connect_private_key"}
        overrides = [f'transport/link/tls/{names[name]}="{path}"' for name, path in files.items()]
        client = client_of(router, *overrides, "transport/link/tls/enable_mtls=true", "listen/endpoints=[]")
        run = launch(*REAL_TIME, "--frames", "20", "--secure", *settings_of(router, **files))
        assert sent(run.ended()) == 20
        assert_recorded(client, run.out, 20)


def layouts() -> list[Path]:
    """The temporary files of a bridge, which deletes them when it is over, also if it was killed."""
    return [*Path(tempfile.gettempdir()).glob("mast-ros2-*/*")]


@pytest.mark.heavy
def test_an_interrupt_ends_a_run_and_its_bridge_also_if_that_is_stuck(launch: Launch) -> None:
    with ros2_router() as router:
        run = launch(*COORDINATED, "--frames", "2000", *settings_of(router))
        run.until(layouts, "the layouts of the bridge")
        run.at_frame(5)
        (bridge,) = [child for child in psutil.Process(run.process.pid).children() if "ros2" in child.cmdline()]
        bridge.suspend()
        output = run.interrupted()
        assert not alive([bridge.pid])
        assert "has not sent the last frames" not in output
        eventually(lambda: not layouts(), "the layouts are deleted", 20)


@pytest.mark.heavy
def test_a_run_whose_bridge_is_killed_says_since_when_it_had_none(launch: Launch) -> None:
    with ros2_router() as router:
        run = launch(*COORDINATED, "--frames", "60", *settings_of(router))
        run.at_frame(5)
        (bridge,) = [child for child in psutil.Process(run.process.pid).children() if "ros2" in child.cmdline()]
        bridge.kill()
        output = run.ended()
    match = re.search(r"exit code -9 at frame (\d+) of 60: the run had none from then on", output)
    assert match, output
    assert 5 <= int(match[1]) < 60
    eventually(lambda: not layouts(), "the layouts are deleted", 20)


@pytest.mark.heavy
def test_a_scenario_can_ask_for_every_frame_in_lock_step(launch: Launch, client_of: Any) -> None:
    with ros2_router() as router:
        client = client_of(router)
        run = launch(*COORDINATED, "--frames", "20", "--set", "ros2.every_frame=true", *settings_of(router))
        assert sent(run.ended()) == 20
        assert_recorded(client, run.out, 20)


@pytest.mark.heavy
def test_in_lock_step_the_newest_frames_are_sent_at_a_pace_that_costs_little(launch: Launch, client_of: Any) -> None:
    with ros2_router() as router:
        client = client_of(router)
        run = launch(*COORDINATED, "--frames", "80", *settings_of(router))
        output = run.ended()
        number = sent(output)
        assert 0 < number < 80
        assert f"sent: {number} of 80 frames: in lock-step" in output
        eventually(lambda: client.counts()["/clock"] == number, "the frames")
        received = client.messages()
    expected = expected_messages(open_recorded(run.out), TOPICS)
    stamps = [message["clock"] for message in expected["/clock"]]
    rows = [stamps.index(message["clock"]) for message in received["/clock"]]
    assert rows == sorted(set(rows))
    assert rows[-1] == 79, "the last frame is sent at least"
    for topic in ("/tf", "/cc/picture", "/cc/picture/markers", "/agent/infra_1/tracks/received/tracked_objects"):
        assert received[topic] == [expected[topic][row] for row in rows], topic


@pytest.mark.heavy
def test_a_running_run_can_be_bridged_later_with_every_frame(launch: Launch, client_of: Any) -> None:
    with ros2_router() as router:
        client = client_of(router)
        run = launch(*COORDINATED, "--frames", "50")
        record = run.at_frame(5)
        broker = psutil.Process(record["nodes"]["broker"]["pid"])
        broker.suspend()  # the run waits for it
        command = [*MAST, "ros2", record["endpoint"], f"--router={router}", "--every-frame"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as bridge:
            assert bridge.stdout is not None
            assert any(line.startswith("rviz: ") for line in bridge.stdout)
            broker.resume()
            code, own = run.end()
            assert code == 0, own
            output, _ = bridge.communicate(timeout=60)
        assert bridge.returncode == 0, output
        received = client.messages()
    expected = expected_messages(open_recorded(run.out), TOPICS)
    stamps = [message["clock"] for message in expected["/clock"]]
    rows = [stamps.index(message["clock"]) for message in received["/clock"]]
    assert rows == sorted(set(rows))
    assert len(rows) > 20
    pictures = received["/cc/picture"]
    shown = [stamps.index(picture["header"]["stamp"]) for picture in pictures]
    assert pictures == [expected["/cc/picture"][row] for row in shown]
    if "frames were lost" not in output:  # a router drops what a starved bridge does not take, and the bridge says so
        assert shown == rows, output
    assert shown == sorted(set(shown))
    assert len(shown) > 20


@pytest.mark.heavy
def test_without_a_router_of_ros_the_run_goes_on_and_says_so(launch: Launch) -> None:
    output = launch(*COORDINATED, "--frames", "10", *settings_of("tcp/127.0.0.1:9")).ended()
    assert "tcp/127.0.0.1:9: nothing answers there (Connection refused), expected a router of rmw_zenoh" in output
    assert "warning: the bridge to ROS 2 has ended with exit code 26: the run had none" in output


@pytest.mark.heavy
def test_a_bridge_ends_with_a_launcher_that_is_killed(launch: Launch) -> None:
    with ros2_router() as router:
        run = launch(*REAL_TIME, "--frames", "1000", *settings_of(router))
        run.started()
        (bridge,) = [child for child in psutil.Process(run.process.pid).children() if "ros2" in child.cmdline()]
        run.process.kill()
        eventually(lambda: not alive([bridge.pid]), "the end of the bridge", 20)
