"""User-defined checks: in the files of a scenario, applied to its finished runs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

import numpy as np

from mast_zenoh.checks.base import Check
from mast_zenoh.config import loading, plugins
from mast_zenoh.config.resolved import Resolved
from mast_zenoh.control.failures import described, location


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
