"""Studies: many runs, compared. The package can be called: `mast_zenoh.study("case_study")` carries out a study.

    interface   what calling the package does, and the object that it returns
    definition  study files, checked, their grids spread out into configurations
    comparison  every configuration once, with a run folder and a report each
    trials      many seeds, kept one by one, resumed:
                plan (which trials), identity (what each depends on), trial (one of them), execution (here, or on a
                Dask cluster), store (the folder)
    tables      what many trials leave: numbers (of one run), results (with increments), parameters (columns of the
                grid), table_file (Parquet), statistics (intervals), summary (one estimate per configuration and series)

See docs/studies.md.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mast_zenoh.study.interface import FinishedStudy


class _Study(ModuleType):
    """This package as the function `mast_zenoh.study`: a package and a function of one name are one object."""

    def __call__(self, study: str, **options: Any) -> FinishedStudy:
        from mast_zenoh.study.interface import carry_out

        return carry_out(study, **options)


sys.modules[__name__].__class__ = _Study
