"""The example in docs/interception.md works as written."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.heavy

PAGE = Path(__file__).parents[2] / "docs" / "interception.md"


@pytest.mark.mesh
def test_every_file_and_command_of_the_example_works_as_written(tmp_path: Path) -> None:
    example = PAGE.read_text().split("## An example")[1].split("\n## ")[0]
    environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
    blocks = re.findall(r"^```(console terminal=1|console|python file=(\S+))\n(.*?)^```$", example, flags=re.S | re.M)
    assert len(blocks) == len(re.findall(r"^```\w", example, flags=re.M)) == 4, "a block that no test runs"
    (_, _, first), *files, (_, _, others) = blocks
    run = subprocess.Popen(first.removeprefix("$ ").split(), cwd=tmp_path, env=environment, stdout=subprocess.DEVNULL)
    try:
        for _, file, text in files:
            (tmp_path / file).write_text(text)
        record, deadline = tmp_path / "watched" / "run.json", time.monotonic() + 60
        while not (record.is_file() and json.loads(record.read_text())["nodes"]):
            assert run.poll() is None
            assert time.monotonic() < deadline
            threading.Event().wait(0.05)
        for line in others.splitlines():
            process = subprocess.run(
                line.removeprefix("$ "),
                shell=True,
                cwd=tmp_path,
                env=environment,
                capture_output=True,
                text=True,
                check=False,
            )
            assert process.returncode == 0, f"{line}\n{process.stdout}{process.stderr}"
    finally:
        run.send_signal(signal.SIGINT)
        run.wait(60)
    did = [(entry["action"], entry["node"]) for entry in json.loads(record.read_text())["interceptions"]]
    assert did == [(action, name) for name in ("half_1", "late", "mallory") for action in ("intercept", "release")]
    measured = json.loads((tmp_path / "watched" / "metrics.json").read_text())["interposers"]["late"]
    assert measured["effects"]["moved"] > 0
