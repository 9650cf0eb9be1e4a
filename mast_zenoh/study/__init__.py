"""Studies: many runs, compared.

The package can be called: `mast_zenoh.study("case_study")` carries out a study.

    interface   what calling the package does, and the object that it returns
    definition  study files: validation, and expansion of grids into configurations
    comparison  every configuration once, with a run folder and a report each
    trials      many seeds, one result file per trial, resumable:
                plan (list of trials), identity (digest of a trial's inputs), trial (what a trial and its outcome are),
                trial_run (runs one), execution (in this process or on a Dask cluster), store (the study folder)
    tables      outputs of many trials: numbers (of one run), results (with increments), parameters (grid columns),
                table_file (Parquet), statistics (intervals), summary (one estimate per configuration and series)
    defences    studies of defences against adversaries

See docs/studies.md.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mast_zenoh.study.interface import FinishedStudy


class _Study(ModuleType):
    """This package, callable as `mast_zenoh.study`: module and function in one."""

    def __call__(self, study: str, **options: Any) -> FinishedStudy:
        from mast_zenoh.study.interface import carry_out

        return carry_out(study, **options)


sys.modules[__name__].__class__ = _Study
