"""A foreign client of ROS 2: zenoh-ros2-sdk in a process of its own, and a router with the settings of rmw_zenohd."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import traceback
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

#: What rmw_zenohd sets apart from Zenoh's defaults, as far as slow peers are concerned.
_RMW_ZENOHD: Mapping[str, Any] = {
    "transport/link/tx/lease": 60_000,
    "transport/link/tx/keep_alive": 2,
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 5_000_000,
}


@contextmanager
def ros2_router(settings: Mapping[str, Any] | None = None, protocol: str = "tcp") -> Iterator[str]:
    """A router of rmw_zenoh, at the endpoint that is yielded. settings: others than those of rmw_zenohd"""
    from mast_zenoh.mesh.session import open_session

    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"{protocol}/127.0.0.1:{free.getsockname()[1]}"
    own = {"mode": "router", "listen/endpoints": [endpoint], "transport/link/tx/queue/size/data": 2}
    with open_session({**own, **_RMW_ZENOHD, **(settings or {})}):
        yield endpoint


class ForeignClient:
    """zenoh-ros2-sdk in a process of its own.

    topics: by name, the type that it subscribes to;  overrides: settings of its session, as rmw_zenoh takes them
    """

    def __init__(
        self, endpoint: str, topics: Mapping[str, str], out: Path, *, domain: int = 0, overrides: Iterable[str] = ()
    ) -> None:
        pytest.importorskip("zenoh_ros2_sdk", reason="zenoh-ros2-sdk is not installed", exc_type=ImportError)
        self._out = out
        words = [f'connect/endpoints=["{endpoint}"]', *overrides]
        self.process = subprocess.Popen(
            [sys.executable, __file__, json.dumps(dict(topics)), str(out), str(domain)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "ZENOH_CONFIG_OVERRIDE": ";".join(words)},
        )
        self._expect("ready")

    def __enter__(self) -> ForeignClient:
        return self

    def __exit__(self, *_: object) -> None:
        with self.process:
            self.process.kill()

    def graph(self) -> dict[str, dict[str, Any]]:
        """By topic, its `types` and the names of its `nodes`."""
        return dict(self._ask("graph"))

    def counts(self) -> dict[str, int]:
        """By topic, the number of messages that have arrived."""
        return dict(self._ask("counts"))

    def messages(self) -> dict[str, list[dict[str, Any]]]:
        """By topic, the messages that have arrived, as dicts of their fields."""
        self._ask("write")
        return dict(json.loads(self._out.read_text()))

    def stall(self) -> None:
        """Stop the process, as a debugger does."""
        self.process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Let the process go on."""
        self.process.send_signal(signal.SIGCONT)

    def _ask(self, question: str) -> Any:
        assert self.process.stdin is not None
        self.process.stdin.write(question + "\n")
        self.process.stdin.flush()
        return json.loads(self._expect(""))

    def _expect(self, start: str) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line.startswith(start), f"the client has ended: {line!r}"
        assert line, "the client has ended"
        return line


def expected_messages(run: Any, topics: Iterable[str], namespace: str = "/") -> dict[str, list[Any]]:
    """By topic, what the bridge publishes of a finished run, as a client has it."""
    from mast_ros2.run_messages import RunMessages
    from mast_ros2.type_store import STORE, decode, encode

    from mast_zenoh.runs.recorded import frames_of

    wanted, messages = set(topics), RunMessages(run, namespace)
    result: dict[str, list[Any]] = {topic: [] for topic in topics}
    for pairs in (messages.transient_local(), *(messages.of(frame, wanted.__contains__) for frame in frames_of(run))):
        for topic, message in pairs:
            if topic in wanted:
                received = decode(message.__msgtype__, encode(message))
                result[topic].append(plain_message(received, STORE.fielddefs))
    return result


def plain_message(message: Any, fields: Mapping[str, Any]) -> Any:
    """A message as a dict of its fields, sequences as lists. fields: of all types, as rosbags' store has them"""
    if hasattr(message, "__msgtype__"):
        names = [name for name, _ in fields[message.__msgtype__][1]]
        return {name: plain_message(getattr(message, name), fields) for name in names}
    if hasattr(message, "tolist"):
        return message.tolist()
    return [plain_message(each, fields) for each in message] if isinstance(message, list) else message


def main() -> None:
    """Subscribe to topics, and answer questions from standard input."""
    topics, out, domain = json.loads(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    sys.path[:0] = [str(Path(__file__).parents[3]), str(Path(__file__).parents[1])]
    import zenoh_ros2_sdk as sdk
    from mast_ros2.type_store import STORE, type_hash

    session = sdk.ZenohSession.get_instance()
    session.store = STORE  # otherwise it fetches definitions from the network
    received: dict[str, list[Any]] = {topic: [] for topic in topics}
    subscribers = []
    for topic, kind in topics.items():
        session._registered_types[kind] = kind
        kept = ":1:,1:,:,:,,"  # transient_local
        subscriber = sdk.ROS2Subscriber(
            topic,
            kind,
            received[topic].append,
            msg_definition="",
            type_hash=type_hash(kind),
            domain_id=domain,
            node_name="listener",
            qos=kept if topic == "/tf_static" else "::,10:,:,:,,",
        )
        subscribers.append(subscriber)
    list(session.liveliness.get(f"@ros2_lv/{domain}/**", timeout=2.0))  # the router knows of the subscriptions
    print("ready", flush=True)
    for line in sys.stdin:
        if line.strip() == "graph":
            answer: Any = {}
            for name, kinds in sdk.get_topic_names_and_types(domain):
                info = sdk.get_topic_info(name, domain, verbose=True)
                nodes = [f"{each.node_namespace.rstrip('/')}/{each.node_name}" for each in info.publishers]
                answer[name] = {"types": kinds, "nodes": nodes}
        elif line.strip() == "counts":
            answer = dict(Counter({topic: len(messages) for topic, messages in received.items()}))
        else:
            fields = STORE.fielddefs
            plain = {topic: [plain_message(each, fields) for each in messages] for topic, messages in received.items()}
            out.write_text(json.dumps(plain))
            answer = len(plain)
        print(json.dumps(answer), flush=True)
    session.close()


if __name__ == "__main__":
    try:
        main()
    except BaseException:
        traceback.print_exc()
        os._exit(1)  # callbacks of Zenoh would keep the process
