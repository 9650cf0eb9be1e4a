"""Checks over the record of a finished run: what must hold whatever was lost, late, killed or cut off.

    base         what a check says
    evidence     what a run has left behind, read once
    collation    what was delivered in time is in the collation
    convergence  after the last heal the picture is what it would have been;  reference  what it would have been
    sequences    no hole and no double that nothing explains
    processes    nothing is left running
    user_checks  those in the files of a scenario

See docs/faults.md.
"""

from __future__ import annotations

import json
from pathlib import Path

from mast_zenoh.checks.base import Check
from mast_zenoh.checks.collation import check_collation
from mast_zenoh.checks.convergence import check_convergence
from mast_zenoh.checks.evidence import Evidence
from mast_zenoh.checks.processes import check_processes
from mast_zenoh.checks.sequences import check_sequences
from mast_zenoh.checks.user_checks import RunCheck, apply, of_scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import RunFolderError

__all__ = ["FILE", "Check", "RunCheck", "run", "wanted"]

FILE = "checks.json"


def wanted(resolved: Resolved) -> bool:
    """Whether runs of a scenario are checked: those with links or faults, and those with checks of the user."""
    return any(entry["kind"] != "attack" for entry in resolved.timeline) or bool(of_scenario(resolved))


def run(folder: Path, resolved: Resolved) -> list[Check]:
    """Check the run in a folder, and write checks.json there; a run that was not recorded is checked for processes.

    Raises RunFolderError where there is no run.
    """
    heals: list[float] = []
    try:
        evidence = Evidence.read(folder, resolved)
    except RunFolderError as error:
        found = [Check.skipped(name, str(error)) for name in ("collation", "convergence", "sequences")]
    else:
        found = [check_collation(evidence), check_convergence(evidence), check_sequences(evidence)]
        heals = evidence.heals_s()
    found.append(check_processes(folder))
    found += [apply(kind, folder) for kind in of_scenario(resolved)]
    after = next((check.values.get("converged_after_s") for check in found if check.name == "convergence"), None)
    content = {"checks": [check._asdict() for check in found], "heals_s": heals, "converged_after_s": after}
    (folder / FILE).write_text(json.dumps(content, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return found
