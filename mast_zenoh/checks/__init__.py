"""Checks on the record of a finished run, which must pass whatever faults occurred.

See docs/faults.md.

evidence     the outcome of a check, and the record of a run, read once
messages     messages delivered in time are in the collation; every gap and every duplicate is explained
convergence  after the last heal, the picture converges to that of the same run without links and faults
runs         no process is left running, and checks in the files of a scenario
"""

from __future__ import annotations

import json
from pathlib import Path

from mast_zenoh.checks.convergence import check_convergence
from mast_zenoh.checks.evidence import Check, RunEvidence
from mast_zenoh.checks.messages import check_collation, check_sequences
from mast_zenoh.checks.runs import RunCheck, apply, check_processes, of_scenario
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.errors import RunFolderError
from mast_zenoh.run_folder import write_bytes

__all__ = ["FILE", "Check", "RunCheck", "is_checked", "run"]

FILE = "checks.json"


def is_checked(resolved: Resolved) -> bool:
    """Whether a scenario is checked: it has links, faults or user-defined checks."""
    return any(entry["kind"] != "attack" for entry in resolved.timeline) or bool(of_scenario(resolved))


def run(folder: Path, resolved: Resolved) -> list[Check]:
    """Check the run in a folder, and write checks.json there.

    Without a recording, only the process check and the user's checks run.
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
    write_bytes(folder / FILE, (json.dumps(content, indent=2, allow_nan=False) + "\n").encode())
    return checks
