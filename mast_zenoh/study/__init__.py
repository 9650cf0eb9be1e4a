"""Studies: many runs, compared.

The package can be called: `mast_zenoh.study("case_study")` carries out a study.

    interface   what calling the package does; runs every configuration once
    finished    a finished study as an object
    choices     what study files name: presets, kinds of scene, defences, adversaries
    definition  study files: validation, and expansion of grids into configurations
    trials      many seeds: plans, runs and resumes trials
    trial       what a trial and its outcome are, and the digest of its inputs
    execution   runs trials, in this process or on a Dask cluster
    store       the study folder: a file for each trial, tables written in pieces
    numbers     the numbers of a trial, with increments over the baseline
    statistics  all 95 % intervals, one estimate per configuration and series, times until detection
    tables      all files of a finished study
    attacked_run  what an attacker without a role achieves at each security level
    defences/   studies of defences against adversaries

See docs/how-to-studies.md.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mast_zenoh.study.finished import FinishedStudy


class _Study(ModuleType):
    """This package, callable as `mast_zenoh.study`: module and function in one."""

    def __call__(self, study: str, **options: Any) -> FinishedStudy:
        from mast_zenoh.study.interface import carry_out

        return carry_out(study, **options)


sys.modules[__name__].__class__ = _Study
