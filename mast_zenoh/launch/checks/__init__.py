"""Checks on the record of a finished run, which must pass whatever faults occurred.

See docs/how-to-scenarios.md#faults.

evidence     the outcome of a check, and the record of a run, read once
messages     messages delivered in time are in the collation; every gap and every duplicate is explained
convergence  after the last heal, the picture converges to that of the same run without links and faults

Here are that no process is left running, and checks in the files of a scenario.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np

from mast_zenoh.config import loading, plugins
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import RunFolderError
from mast_zenoh.launch.checks.convergence import check_convergence
from mast_zenoh.launch.checks.evidence import Check, RunEvidence
from mast_zenoh.launch.checks.messages import check_collation, check_sequences
from mast_zenoh.mesh.control.failures import described, location
from mast_zenoh.run_folder import read_object, write_json

__all__ = ["FILE", "Check", "RunCheck", "is_checked", "run"]

FILE = "checks.json"


def is_checked(resolved: Resolved) -> bool:
    """Whether a scenario is checked: it has links, faults or user-defined checks."""
    return any(entry["kind"] != "attack" for entry in resolved.timeline) or bool(of_scenario(resolved))


def run(folder: Path, resolved: Resolved) -> list[Check]:
    """Check the run in a folder, and write checks.json there.

    Without a recording, only the process check and the user's checks run.

    Keys:
    checks: each with `name`, `ok` (null: skipped), `detail` and `values`
    heals_s: times at which faults ended
    converged_after_s: after which the picture was as without them; null: not known
    """
    heals: list[float] = []
    try:
        evidence = RunEvidence.read(folder, resolved)
    except RunFolderError as error:
        checks = [Check.skipped(name, str(error)) for name in ("collation", "convergence", "sequences")]
    else:
        checks = [check_collation(evidence), check_convergence(evidence), check_sequences(evidence)]
        heals = evidence.heals_s()
    checks.append(check_processes(folder))
    checks += [apply(check, folder) for check in of_scenario(resolved)]
    converged_after_s = next(
        (check.values.get("converged_after_s") for check in checks if check.name == "convergence"), None
    )
    content = {
        "checks": [check._asdict() for check in checks],
        "heals_s": heals,
        "converged_after_s": converged_after_s,
    }
    write_json(folder / FILE, content)
    return checks


_PROCESSES = "processes"  # of the check
_PROC = Path("/proc")


def check_processes(folder: Path) -> Check:
    """Check that no process has the id and folder of the run on its command line."""
    run = read_object(folder / "run.json")
    if run.get("runtime") == "inproc":
        return Check.skipped(_PROCESSES, "the run was a single process")
    if not _PROC.is_dir():
        return Check.skipped(_PROCESSES, "this system does not show its processes under /proc")
    remaining = _running(str(folder), str(run.get("id", "")))
    if remaining:
        processes = ", ".join(f"{name} ({pid})" for pid, name in sorted(remaining.items()))
        return Check(_PROCESSES, False, f"still running: {processes}", {"checked": True, "left": sorted(remaining)})
    return Check(_PROCESSES, True, f"none of {len(run.get('nodes', {}))} nodes is left", {"checked": True, "left": []})


def _running(folder: str, run: str) -> dict[int, str]:
    """Node names by process id, of processes with this folder and run id."""
    nodes = {}
    for entry in _PROC.iterdir():
        if not entry.name.isdigit():
            continue
        try:
            arguments = (entry / "cmdline").read_bytes().decode(errors="replace").split("\0")
            state = (entry / "stat").read_text().rpartition(")")[2].split()[0]
        except (OSError, IndexError):
            continue  # it has just ended, or belongs to another user
        if state not in "ZX" and folder in arguments and run in arguments and "--name" in arguments:
            nodes[int(entry.name)] = arguments[arguments.index("--name") + 1]
    return nodes


class RunCheck(ABC):
    """Checks a finished run.

    A subclass that a scenario's file defines or imports is applied to every run of the scenario.
    """

    @abstractmethod
    def check(self, folder: Path) -> tuple[bool, str]:
        """Whether the check passes, and a sentence with the findings.

        folder: of the run; `mast_zenoh.open(folder)` reads its messages, metrics and tables

        If it raises an exception, it fails.
        """


def of_scenario(resolved: Resolved) -> list[type[RunCheck]]:
    """The concrete subclasses of RunCheck in the files of a scenario and in the plugins that it uses."""
    of_files = loading.concrete([loading.module(Path(file)) for file in resolved.modules], RunCheck)
    return of_files + plugins.classes_for(resolved.plugins, RunCheck)


def apply(check_class: type[RunCheck], folder: Path) -> Check:
    """The outcome of a user's check on the run in a folder."""
    try:
        ok, detail = result = check_class().check(folder)
        if not isinstance(ok, (bool, np.bool_)) or not isinstance(detail, str):
            raise TypeError(f"found {result!r:.80}, expected (True or False, a sentence)")
    except (Exception, SystemExit) as error:
        where = location(error, check_class.check)
        return Check(
            check_class.__name__, False, f"the check itself failed: {described(error)} ({where})", {"checked": True}
        )
    return Check(check_class.__name__, bool(ok), detail, {"checked": True})
