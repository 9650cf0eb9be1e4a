"""What is seen of a run or of compared runs: pages, tables, figures, films, and files for other programs.

See docs/how-to-read-a-report.md and docs/how-to-studies.md.

comparison         the reference run of a comparison;  compare  the scores of several runs side by side
run_figure         the base class of figures of a run, those of users included
figures/           the pictures and charts of runs and of studies
film/              films and stills of runs
tables/            rows and cells, for every output;  number_text  numbers and their intervals in words
study_columns      the measures of a study that tables and sentences compare
findings/          what is worth saying of a run, as data, and the words, of studies too
html               the pages, rendered from templates/;  page/  the part that plays runs in a browser
terminal           results on the terminal
export/            files of runs for other programs, by formats
palette            all colours
"""

from __future__ import annotations

from mast_zenoh.show.run_figure import FigureContext, RunFigure

__all__ = ["FigureContext", "RunFigure"]
