"""Handler failures are counted by frame and located in the node's code."""

import asyncio
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import failing
import numpy as np
import pytest
from tiny_world import tiny

from mast_zenoh import scenario
from mast_zenoh.attacks import UncoordinatedAttack
from mast_zenoh.config import bundle
from mast_zenoh.config.resolved import ProcessStep
from mast_zenoh.errors import NodeDied, StartError
from mast_zenoh.mesh.control import failures
from mast_zenoh.mesh.host import Host
from mast_zenoh.mesh.inproc import InProcess
from mast_zenoh.messages.schemas import Header, Message
from mast_zenoh.node import Context, Node, Overheard, Received
from mast_zenoh.wiring.model import ANY, Input, Ports

ENTRY = {
    "handler": "on_tracks",
    "count": 3,
    "frames": 2,
    "first_frame": 4,
    "last_frame": 9,
    "exception": "KeyError: 'x'",
    "where": "/a/node.py:3",
}


def hosting(node: Node, message: str = "clock", port: str = "clock") -> Host:
    """A host of a node that receives one key."""
    return Host("n", node, Ports({"s": Input(port, "a", message, "a")}, {}), 0, encode=False, emit=print)


def send(host: Host, frame: int = 0, step: int = 0) -> None:
    """Deliver a clock of this frame."""
    host.deliver("s", Message(Header("clock", "a", frame, 0, 0), {}), step)


def raised(call: Callable[[], Any]) -> BaseException:
    with pytest.raises(BaseException) as caught:  # noqa: PT011 (whatever it is)
        call()
    return caught.value


def test_a_failure_is_located_at_the_innermost_line_of_a_node_or_an_algorithm(tmp_path: Path) -> None:
    path = failing.write("attack", tmp_path)
    process = InProcess(scenario.resolve(*scenario.load(str(path), []), frames=7))
    process.run()
    line = 1 + path.read_text().splitlines().index('            raise ValueError(f"no [plan] for frame {frame}")')
    assert process.failures() == {
        "eve": [
            {
                "handler": "on_detections",
                "count": 2,
                "frames": 2,
                "first_frame": 5,
                "last_frame": 6,
                "exception": "ValueError: no [plan] for frame 5",
                "where": f"{path}:{line}",
            }
        ]
    }


def test_an_error_raised_in_a_library_or_the_runtime_is_located_at_its_caller() -> None:
    def in_numpy() -> None:
        np.zeros(3).reshape(7)

    def in_json() -> None:
        json.loads("{")

    def in_received() -> None:
        _ = Overheard("s", Input("everything", "", "clock", "simulator"), b"rubbish", 0).header

    for call in (in_numpy, in_json, in_received):
        assert failures.location(raised(call), call) == f"{__file__}:{call.__code__.co_firstlineno + 1}"


def test_an_error_raised_in_an_algorithm_is_located_first_at_the_line_of_the_user_that_called_it() -> None:
    def too_early() -> None:
        UncoordinatedAttack(start_s=-1.0)

    where = failures.location(raised(too_early), too_early)
    first, _, then = where.partition(", raised in ")
    assert first == f"{__file__}:{too_early.__code__.co_firstlineno + 1}"
    assert Path(then.rpartition(":")[0]).is_relative_to(bundle.ROOT / "mast_zenoh")


def test_a_handler_with_wrong_parameters_is_located_where_it_is_defined() -> None:
    class Wrong(Node):
        inputs = {"clock": "clock"}

        def on_clock(self, received: Received) -> None: ...

    host = hosting(Wrong())
    send(host)
    where = host.failures["on_clock"].where
    assert where == f"{__file__}:{Wrong.on_clock.__code__.co_firstlineno}"
    assert "TypeError" in host.failures["on_clock"].exception


def test_an_exception_is_described_on_one_short_line_even_if_it_cannot_format_itself() -> None:
    class Mute(Exception):
        def __str__(self) -> str:
            raise ValueError

    assert failures.described(Mute()) == "Mute"
    assert failures.described(KeyError("x")) == "KeyError: 'x'"
    assert failures.described(ValueError("a\n  b\n" + "c" * 999)) == f"ValueError: a b {'c' * 284}"


@pytest.mark.parametrize("error", [SystemExit(0), GeneratorExit(), asyncio.CancelledError("late")])
def test_no_error_of_a_handler_ends_the_process(error: BaseException) -> None:
    class Leaver(Node):
        inputs = {"clock": "clock"}

        def on_clock(self, received: Received, context: Context) -> None:
            raise error

    host = hosting(Leaver())
    send(host)
    assert host.failures["on_clock"].exception.startswith(type(error).__name__)


def test_a_node_without_a_clock_fails_in_the_frame_of_its_message() -> None:
    class Fails(Node):
        inputs = {"status": "status"}

        def on_status(self, received: Received, context: Context) -> None:
            raise ValueError

    body = {"mobile": np.array([0]), "detections": np.array([1]), "tracks": np.array([2])}
    host = hosting(Fails(), "status", "status")
    for frame, step in ((3, 3), (4, 6), (5, -1)):
        host.deliver("s", Message(Header("status", "a", frame, 0, 0), body), step)
    assert host.failures["on_status"].frames == {3, 6, -1}, "delayed: the frame in which it was forwarded"


def test_a_node_that_receives_every_key_fails_in_the_frame_of_its_message() -> None:
    class Fails(Node):
        inputs = {"everything": ANY}

        def on_everything(self, overheard: Overheard, context: Context) -> None:
            raise ValueError

    host = hosting(Fails(), port="everything")
    send(host, 2, 2)
    host.deliver("s", b"rubbish", 3)
    assert host.failures["on_everything"].frames == {2, 3}
    assert host.failures["on_everything"].count == 2


@pytest.mark.parametrize(
    "returned", [[1, 2], {"names": {"ego"}}, {(1, 2): 3}, {"x": 1 << 70}, {"a": np.zeros(2, "M8[s]")}]
)
def test_unserialisable_results_are_a_failure_of_finish(returned: Any) -> None:
    class Returns(Node):
        takes = (ANY,)

        def on_message(self, received: Received, context: Context) -> None:
            pass

        def finish(self, context: Context) -> Any:
            return returned

    host = hosting(Returns())
    assert host.finish() == {}
    assert host.failures["finish"].exception.startswith("TypeError: ")
    assert host.failures["finish"].where == f"{__file__}:{Returns.finish.__code__.co_firstlineno}"


def test_failures_of_one_node_in_several_processes_are_one_entry() -> None:
    again = ENTRY | {"count": 1, "frames": 1, "first_frame": 12, "last_frame": 12, "exception": "KeyError: 'y'"}
    other = ENTRY | {"handler": "joined"}
    assert failures.merged([[ENTRY], [other, again]]) == [other, ENTRY | {"count": 4, "frames": 3, "last_frame": 12}]


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ((3, 2, 4, 9), "failed 3 times in 2 frames (4 to 9)"),
        ((1, 1, 4, 4), "failed once in frame 4"),
        ((5, 1, 4, 4), "failed 5 times in frame 4"),
        ((1, 1, -1, -1), "failed once before the first frame"),
    ],
)
def test_a_failure_is_described_as_text(numbers: tuple[int, ...], words: str) -> None:
    entry = ENTRY | dict(zip(("count", "frames", "first_frame", "last_frame"), numbers, strict=True))
    (line,) = failures.lines({"ego": [entry]}, {"ego": "logs/ego.log"})
    assert line == f"ego.on_tracks {words}: KeyError: 'x' (/a/node.py:3); log: logs/ego.log"


def test_failures_before_a_kill_count_in_one_process(tmp_path: Path) -> None:
    file, loaded = scenario.load(str(failing.write("attack", tmp_path)), [])
    steps = (ProcessStep(7, "kill", "eve"), ProcessStep(9, "start", "eve"))
    process = InProcess(replace(scenario.resolve(file, loaded, frames=12), steps=steps))
    process.run()
    (entry,) = process.failures()["eve"]
    assert (entry["count"], entry["first_frame"], entry["last_frame"]) == (5, 5, 11)


@pytest.mark.parametrize("raised", [RuntimeError, SystemExit, GeneratorExit, asyncio.CancelledError])
@pytest.mark.parametrize(
    ("method", "error", "words"),
    [
        ("start", StartError, "eve.start failed once before the first frame"),
        ("advance", NodeDied, "simulator.advance failed before frame 0"),
    ],
)
def test_a_node_that_cannot_start_and_a_scene_that_fails_end_the_run(method, error, words, raised, monkeypatch) -> None:
    process = InProcess(tiny("uncoordinated", "n_adversaries=1"))
    name = "adversary_1" if method == "start" else "simulator"

    def fail(*_: object) -> None:
        raise raised("on purpose")

    monkeypatch.setattr(process.hosts[name].node, method, fail)
    with pytest.raises(error, match=rf"{words.replace('eve', name)}: {raised.__name__}: on purpose"):
        process.run()


@pytest.mark.parametrize("method", ["start", "advance"])
def test_ctrl_c_is_not_counted_as_a_failure_of_the_node(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    process = InProcess(tiny("uncoordinated", "n_adversaries=1"))

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(process.hosts["simulator"].node, method, interrupted)
    with pytest.raises(KeyboardInterrupt):
        process.run()
    assert process.failures() == {}
