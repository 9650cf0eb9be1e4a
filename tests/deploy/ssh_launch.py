"""The launcher of a run over SSH, as a program that runs in a namespace.

python ssh_launch.py run   HOSTS.toml '{"frames": 20, "secure": "acl", "n_infrastructure": 7, "steps": [], …}' OUT
python ssh_launch.py check HOSTS.toml...      errors: {file: [exit code, message]}
python ssh_launch.py status|logs|down OUT     like `mast deploy`, from the run folder alone
"""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

from mast_zenoh import scenario
from mast_zenoh.config.resolved import ProcessStep, Resolved
from mast_zenoh.deploy.ssh.engine import Ssh
from mast_zenoh.errors import MastError
from mast_zenoh.launch import run as launcher


def resolved(
    frames: int = 20, mode: str = "lockstep", n_infrastructure: int = 7, steps: tuple[tuple[int, str, str], ...] = ()
) -> Resolved:
    """n_infrastructure + 1 agents."""
    path, loaded = scenario.load("baseline", [f"n_infrastructure={n_infrastructure}"])
    resolved_scenario = scenario.resolve(path, loaded, frames=frames, mode=mode, record=True)
    return replace(resolved_scenario, steps=tuple(ProcessStep(*step) for step in steps))


def run(hosts: str, options: str, out: str) -> None:
    settings: dict[str, Any] = json.loads(options)
    secure = settings.pop("secure", "open")
    outcome = launcher.run(resolved(**settings), Path(out), engine=Ssh(Path(hosts)), secure=secure)
    if outcome.error:
        sys.stderr.write(f"{type(outcome.error).__name__}: {outcome.error}\n")
        sys.exit(outcome.error.exit_code)


def check(*files: str) -> None:
    results = {}
    for file in files:
        try:
            Ssh(Path(file)).check(resolved(2, n_infrastructure=1), "open")
            results[Path(file).stem] = [0, ""]
        except MastError as error:
            results[Path(file).stem] = [error.exit_code, str(error)]
    sys.stdout.write(json.dumps(results))


def afterwards(what: str, out: str) -> None:
    folder = Path(out)
    record = json.loads((folder / "run.json").read_text())
    if what == "status":
        sys.stdout.write(json.dumps(Ssh.status(folder, record)))
    elif what == "logs":
        Ssh.logs(folder, record, None, follow=False)
    else:
        Ssh.down(folder, record)


if __name__ == "__main__":
    if sys.argv[1] in ("status", "logs", "down"):
        afterwards(*sys.argv[1:])
    else:
        {"run": run, "check": check}[sys.argv[1]](*sys.argv[2:])
