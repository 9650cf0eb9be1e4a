"""The files of Rerun's web viewer, out of the installed rerun-sdk.

The package has them only inside its program, which serves them. It is started for a moment on the loopback address,
with its usage statistics switched off. Its own page is not used: it names outside hosts.
"""

from __future__ import annotations

import json
import os
import queue
import re
import signal
import subprocess
import sys
import tempfile
import threading
import urllib.request
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from mast_zenoh.errors import ExportError
from mast_zenoh.viewer.loopback import LOOPBACK

#: Names of the files with their media types.
FILES = {"re_viewer.js": "text/javascript", "re_viewer_bg.wasm": "application/wasm"}
_ADDRESS = re.compile(rf"web-viewer at (http://{re.escape(LOOPBACK)}:\d+)")
_DEADLINE_S = 30.0


def web_viewer_files() -> dict[str, bytes]:
    """The contents of FILES; raises ExportError if the installed rerun-sdk does not provide them."""
    command = [sys.executable, "-m", "rerun_cli", "--serve-web", "--bind", LOOPBACK]
    command += ["--port", "auto", "--web-viewer-port", "0"]
    with tempfile.TemporaryDirectory(prefix="mast-rerun-") as home:
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            stdin=subprocess.DEVNULL,
            env=_environment(home),
            start_new_session=True,  # the command starts another process
        )
        try:
            address = _address(process)
            return {name: _fetched(f"{address}/{name}") for name in FILES}
        except OSError as error:
            raise ExportError(f"rerun-sdk: its web viewer cannot be read: {error}: use the native viewer") from None
        finally:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _environment(home: str) -> Mapping[str, str]:
    """Variables for a process that finds its settings in a folder, with usage statistics off."""
    settings = Path(home) / "rerun" / "analytics.json"
    settings.parent.mkdir()
    settings.write_text(json.dumps({"analytics_enabled": False, "analytics_id": "", "metadata": {}}), encoding="utf-8")
    return {**os.environ, "HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home, "NO_COLOR": "1"}


def _address(process: subprocess.Popen[bytes]) -> str:
    """Where the program serves the files, as it prints it; raises OSError if it ends first, or takes too long."""
    found: queue.Queue[str | None] = queue.Queue()
    last = "it printed nothing"

    def read(output: IO[bytes]) -> None:
        nonlocal last
        for line in output:
            text = line.decode("utf-8", "replace").strip()
            last = text or last
            if match := _ADDRESS.search(text):
                found.put(match[1])
        found.put(None)

    assert process.stdout is not None
    threading.Thread(target=read, args=(process.stdout,), daemon=True).start()
    try:
        address = found.get(timeout=_DEADLINE_S)
    except queue.Empty:
        raise TimeoutError(f"no address within {_DEADLINE_S:g} s: {last}") from None
    if address is None:
        raise ChildProcessError(f"the program ended: {last}")
    return address


def _fetched(address: str) -> bytes:
    """What is at an address on this computer, without any proxy."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(address, timeout=_DEADLINE_S) as answer:
        content: bytes = answer.read()
        return content
