"""Starts a node of ROS 2 in a process of its own, which takes part by zenoh-ros2-sdk (ros2_peer.py)."""

import json
import os
import select
import subprocess
import sys
from pathlib import Path
from typing import Any, Self

import pytest
from mast_ros2.mesh import Tls
from mast_ros2.type_store import DETECTIONS, TRACKED_OBJECTS

_START_S = 60.0

#: Topics of a node of ROS 2 in each place of a run: what it receives, and what it sends.
AGENT = ("/mast/infra_1/detections", DETECTIONS, "/mast/infra_1/received_tracks", TRACKED_OBJECTS)
CENTER = (
    *("/mast/command_center/infra_2/tracks", TRACKED_OBJECTS),
    *("/mast/command_center/received_picture", TRACKED_OBJECTS),
)
ADVERSARY = ("/mast/thief/infra_1/tracks/in", TRACKED_OBJECTS, "/mast/thief/infra_1/tracks/out", TRACKED_OBJECTS)


class Ros2Process:
    """A node of ROS 2 on a router, until the end of `with`.

    behaviour: see ros2_peer.py; of ros2_flood.py, its seed
    """

    def __init__(
        self, behaviour: str, router: str, *topics: str, tls: Tls | None = None, file: str = "ros2_peer.py"
    ) -> None:
        pytest.importorskip("zenoh_ros2_sdk", reason="zenoh-ros2-sdk is not installed", exc_type=ImportError)
        environment = dict(os.environ)
        if tls is not None:
            files = {
                "root_ca_certificate": tls.ca,
                "connect_certificate": tls.certificate,
                "connect_private_key": tls.key,
            }
            settings = {"connect/endpoints": [router], "transport/link/tls/enable_mtls": True}
            settings |= {f"transport/link/tls/{name}": str(path) for name, path in files.items()}
            environment["ZENOH_CONFIG_OVERRIDE"] = ";".join(f"{key}={json.dumps(v)}" for key, v in settings.items())
        address = router.partition("/")[2] if file == "ros2_peer.py" else router
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name(file)), behaviour, address, *topics],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
        )
        assert self.process.stdout is not None
        assert select.select([self.process.stdout], [], [], _START_S)[0], "the node of ROS 2 says nothing"
        said = self.process.stdout.readline()
        assert said == "ready\n", said

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: Any) -> None:
        self.kill()

    def kill(self) -> None:
        """End the process at once."""
        self.process.kill()
        self.process.communicate()
