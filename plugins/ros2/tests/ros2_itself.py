"""ROS 2 itself, as a program of its environment: what it makes of payloads and definitions.

Reads from standard input, as JSON:

    payloads:    list of [type, payload as hexadecimal digits]
    definitions: by type that this ROS 2 does not have, its text in the language of `.msg` files
    hashes:      types whose hashes are wanted

and writes as JSON: `payloads`, each read and written again; `hashes` by type; `definitions`, their hashes.
"""

import importlib
import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

#: s, within which a node knows its own publishers.
DEADLINE_S = 20.0


def message_class(type_name: str) -> Any:
    """The class of a type."""
    package, kind, name = type_name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), name)


def rewritten(type_name: str, payload: bytes) -> bytes:
    """A payload after ROS 2 has read and written it."""
    from rclpy.serialization import deserialize_message, serialize_message

    cls = message_class(type_name)
    return serialize_message(deserialize_message(payload, cls))


def hashes_in_the_graph(types: list[str]) -> dict[str, str]:
    """The hashes that a running node announces for its publishers."""
    import rclpy

    rclpy.init()
    node = rclpy.create_node("announcing")
    topics = {f"/topic_{row}": name for row, name in enumerate(types)}
    publishers = [node.create_publisher(message_class(name), topic, 1) for topic, name in topics.items()]
    deadline, found = time.monotonic() + DEADLINE_S, {}
    while len(found) < len(publishers) and time.monotonic() < deadline:
        for topic in topics:
            for info in node.get_publishers_info_by_topic(topic):
                found[info.topic_type] = str(info.topic_type_hash)
        threading.Event().wait(0.05)
    node.destroy_node()
    rclpy.shutdown()
    return found


def hashes_of_definitions(definitions: dict[str, str]) -> dict[str, str]:
    """The hashes that the generators of ROS 2 give to definitions, which may refer to each other."""
    from rosidl_adapter.msg import convert_msg_to_idl
    from rosidl_generator_type_description import generate_type_hash

    installed = [f"{share.name}:{share}" for share in Path(sys.prefix, "share").iterdir()]
    hashes: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder:
        for package in sorted({name.split("/")[0] for name in definitions}):
            root, out = Path(folder, package), Path(folder, "out", package)
            (root / "msg").mkdir(parents=True)
            out.mkdir(parents=True)
            files = []
            for name, text in definitions.items():
                if name.split("/")[0] == package:
                    source = Path("msg", name.split("/")[2] + ".msg")
                    (root / source).write_text(text)
                    convert_msg_to_idl(root, package, source, root / "msg")
                    files.append(f"{root}:{source.with_suffix('.idl')}")
            arguments = root / "arguments.json"
            wanted = {"package_name": package, "output_dir": str(out), "idl_tuples": files, "include_paths": installed}
            arguments.write_text(json.dumps(wanted))
            for described in generate_type_hash(str(arguments)):
                own = json.loads(Path(described).read_text())["type_hashes"][0]
                hashes[own["type_name"]] = own["hash_string"]
    return hashes


def main() -> None:
    """Answer one request. What the generators print goes to standard error."""
    answer, sys.stdout = sys.stdout, sys.stderr
    os.environ.setdefault("ROS_LOG_DIR", tempfile.gettempdir())
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    request = json.load(sys.stdin)
    result = {
        "payloads": [rewritten(name, bytes.fromhex(payload)).hex() for name, payload in request["payloads"]],
        "hashes": hashes_in_the_graph(request["hashes"]),
        "definitions": hashes_of_definitions(request["definitions"]),
    }
    json.dump(result, answer)


if __name__ == "__main__":
    main()
