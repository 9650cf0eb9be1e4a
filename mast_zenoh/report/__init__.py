"""Tables, figures and pages of one run or of compared runs.

See docs/report.md and docs/studies.md.

comparison         the reference run of a comparison;  compare  the scores of several runs side by side
run_figure         the base class of figures of a run, those of users included
figures/           the pictures and charts of runs and of studies
film/              films and stills of runs
tables/            rows and cells, for every output
findings/          what is worth saying of a run, as data, and the words;  narrative/  results of studies in words
html               the pages, rendered from templates/
terminal           results on the terminal
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mast_zenoh.report.html import write_report, write_study_report
    from mast_zenoh.report.run_figure import FigureContext, RunFigure
    from mast_zenoh.report.tables.scores import ScoreTable, as_markdown, as_rich, score_table

#: By name, the module that has it. It is imported at the first use: files of scenarios import `RunFigure`, also in the
#: processes of nodes, which do not draw.
_PLACES = {
    **dict.fromkeys(("write_report", "write_study_report"), "mast_zenoh.report.html"),
    **dict.fromkeys(("FigureContext", "RunFigure"), "mast_zenoh.report.run_figure"),
    **dict.fromkeys(("ScoreTable", "as_markdown", "as_rich", "score_table"), "mast_zenoh.report.tables.scores"),
}

__all__ = [
    "FigureContext",
    "RunFigure",
    "ScoreTable",
    "as_markdown",
    "as_rich",
    "score_table",
    "write_report",
    "write_study_report",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_PLACES[name]), name)
