"""What the code of a node has started ends with its run, however it was started and however the node ends."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from launched import eventually

from mast_zenoh import scenario
from mast_zenoh.launch.processes import Processes, can_fork_nodes

pytestmark = [
    pytest.mark.mesh,
    pytest.mark.skipif(not can_fork_nodes(), reason="this system cannot wait for processes of others"),
]

KINDS = ("fork", "fork in a session of its own", "program", "program in a session of its own")

#: A node file whose code starts processes in every way before it is built.
NODE = """
import os, subprocess, sys, threading
from pathlib import Path

FOLDER, FOREVER = Path({folder!r}), threading.Event()
for kind in {kinds!r}:
    own = kind.endswith("own")
    if kind.startswith("fork"):
        pid = os.fork()
        if not pid:
            if own:
                os.setsid()
            FOREVER.wait()
    else:
        pid = subprocess.Popen(["sleep", "600"], start_new_session=own).pid
    (FOLDER / kind).write_text(str(pid))
(FOLDER / "started").touch()
{ending}
"""


@pytest.mark.parametrize("ending", ["sys.exit(0)", "os._exit(1)", "FOREVER.wait()"], ids=["exits", "dies", "killed"])
def test_no_process_that_a_node_has_started_outlives_the_run(tmp_path: Path, ending: str) -> None:
    resolved = scenario.resolve(*scenario.load("baseline", []), frames=2)
    file = tmp_path / "starting.py"
    file.write_text(NODE.format(folder=str(tmp_path), kinds=KINDS, ending=ending))
    spec = replace(resolved.nodes["infra_1"], file=str(file))
    resolved.nodes["infra_1"] = spec
    resolved.write(tmp_path)
    (tmp_path / "logs").mkdir()
    processes = Processes(tmp_path, "strays-of-a-test", "tcp/127.0.0.1:1")
    processes.start("infra_1", spec)
    (child,) = processes.children.values()
    eventually((tmp_path / "started").exists, "it has started its processes")
    strays = {}
    for kind in KINDS:
        with suppress(psutil.NoSuchProcess):  # a node that exits may have taken it along by now
            strays[kind] = psutil.Process(int((tmp_path / kind).read_text()))
    if ending.startswith("FOREVER"):
        processes.end_now(child)
    else:
        eventually(lambda: child.exit is not None, "the node has ended")
    processes.end(1.0)
    left = {kind: stray for kind, stray in strays.items() if stray.is_running()}
    for stray in left.values():
        stray.kill()
    assert not left
