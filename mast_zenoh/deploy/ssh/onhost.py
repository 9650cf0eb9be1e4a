"""The host's side of `installation`: a standalone program for the host's Python.

    python3 - probe FOLDER ENVIRONMENT RELEASE     prints properties of this host, as JSON
    python3 - unpack NEW TARGET VENV               unpacks wheels in NEW to TARGET, a virtual environment if VENV is 1
    python3 - verify ENVIRONMENT RELEASE           imports what nodes import; prints the version of mast-zenoh
    python3 - reach HOST PORT                      checks whether something answers there
    python3 - remove FOLDER                        removes the folder of a run

Unpacked folders get their name when they are complete, so hosts may share a home.
"""

from __future__ import annotations

import contextlib
import glob
import json
import os
import platform
import shutil
import socket
import subprocess
import sys
import zipfile
from typing import Any

_SAY_VERSION = "from mast_zenoh import version; print(version.version_string())"
_IMPORT_ALL = "import mast_zenoh.deploy.remote_node, mast_zenoh.tracking, mast_zenoh.fusion.pipelines; "


def probe(folder: str, environment: str, release: str) -> dict[str, Any]:
    """Properties of this host, and which of our folders exist."""
    folder = os.path.join(os.path.expanduser("~"), folder)
    facts: dict[str, Any] = {
        "folder": folder,
        "system": platform.system(),
        "machine": platform.machine(),
        "refused": "",
        "version": "",
    }
    try:
        os.makedirs(os.path.join(folder, "runs"), mode=0o700, exist_ok=True)
        for name in ("environments", "releases"):
            os.makedirs(os.path.join(folder, name), exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise OSError("may not be written to")
        facts["free"] = shutil.disk_usage(folder).free
        _sweep(os.path.join(folder, "runs"))
    except OSError as error:
        facts["refused"] = str(error)
        return facts
    environment, release = (
        os.path.join(folder, kind, name) for kind, name in (("environments", environment), ("releases", release))
    )
    facts["environment"], facts["release"] = os.path.exists(environment), os.path.exists(release)
    if facts["environment"] and facts["release"]:
        facts["version"] = _run(environment, release, _SAY_VERSION)
    return facts


def unpack(new: str, target: str, venv: str) -> dict[str, Any]:
    """Unpack wheels, which are zip files, without pip."""
    content = os.path.join(new, "content")
    if venv == "1":
        subprocess.check_call([sys.executable, "-m", "venv", "--without-pip", content])
        (target_folder,) = glob.glob(os.path.join(content, "lib", "python*", "site-packages"))
    else:
        os.mkdir(content)
        target_folder = content
    for wheel in glob.glob(os.path.join(new, "*.whl")):
        with zipfile.ZipFile(wheel) as archive:
            archive.extractall(target_folder)
        os.unlink(wheel)
    for data in glob.glob(os.path.join(target_folder, "*.data", "*lib")):  # PEP 427: purelib and platlib
        for name in os.listdir(data):
            shutil.move(os.path.join(data, name), target_folder)
    try:
        os.rename(content, target)
    except OSError:
        if not os.path.exists(target):
            raise
    shutil.rmtree(new)  # with `content`, if another process was faster
    return {}


def verify(environment: str, release: str) -> dict[str, Any]:
    """Import what nodes import, so that the compiled modules are cached."""
    return {"version": _run(environment, release, _IMPORT_ALL + _SAY_VERSION)}


def reach(host: str, port: str) -> dict[str, Any]:
    """Whether something answers at an address."""
    try:
        socket.create_connection((host, int(port)), timeout=10.0).close()
    except OSError as error:
        return {"refused": str(error)}
    return {"refused": ""}


def remove(folder: str) -> dict[str, Any]:
    """Remove the folder that a killed supervisor has left."""
    if os.path.basename(os.path.dirname(os.path.dirname(folder))) != "runs":
        raise SystemExit(f"{folder} is not the folder of a run")
    shutil.rmtree(folder, ignore_errors=True)
    with contextlib.suppress(OSError):
        os.rmdir(os.path.dirname(folder))
    return {}


def _run(environment: str, release: str, program: str) -> str:
    command = [os.path.join(environment, "bin", "python"), "-c", program]
    done = subprocess.run(command, env=dict(os.environ, PYTHONPATH=release), capture_output=True, check=False)
    lines = (done.stdout if done.returncode == 0 else done.stderr).decode(errors="replace").strip().splitlines()
    return lines[-1] if lines else f"exit code {done.returncode}"


def _sweep(runs: str) -> None:
    """Remove folders of runs whose warden was killed, such as by switching off."""
    for control in glob.glob(os.path.join(runs, "*", "*", "control")):
        folder, former = os.path.dirname(control), os.getcwd()
        with socket.socket(socket.AF_UNIX) as client:
            client.settimeout(5.0)
            os.chdir(folder)  # the path of a socket is limited in length
            try:
                client.connect("control")
            except ConnectionRefusedError:
                # A supervisor on another host with the same home refuses as well, but touches its socket while it runs.
                if os.stat("control").st_mtime + 60.0 < _now(runs):
                    remove(folder)
            except OSError:
                pass
            finally:
                os.chdir(former)


def _now(folder: str) -> float:
    """The file system's time, as the clocks of hosts may differ."""
    probe_file = os.path.join(folder, f".now-{os.getpid()}")
    open(probe_file, "w").close()
    try:
        return os.stat(probe_file).st_mtime
    finally:
        os.unlink(probe_file)


if __name__ == "__main__":
    os.umask(os.umask(0o022) | 0o022)
    programs: dict[str, Any] = {program.__name__: program for program in (probe, unpack, verify, reach, remove)}
    print(json.dumps(programs[sys.argv[1]](*sys.argv[2:])))
