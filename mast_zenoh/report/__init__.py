"""Tables, figures and pages of a run, or of several compared. See docs/report.md and docs/studies.md.

runfolder, files     what a run left behind
comparison           the run that another one is compared with
changes              what changed, of all kinds, and what it is due to
words, phrases       the result in words;  terminal: on the terminal
table                the table of scores
interposers          what each interposer did, and its verdict
achievement, explanations   what attacks achieved, and why something had limited effect
driving              what estimates would mean for driving
faulted, causes      what runs with links, faults or a wall clock have more
view                 what pictures show of a frame, and of which frame
birdseye, camera, figures, charts, bands, timeaxis, style   drawing
wiring, diagram      the wires and the nodes on them
illustrations        which figures a page has;  html, page: the pages themselves
study_*              tables, figures and pages of studies with trials;  attempts_table: of outsiders
"""

from mast_zenoh.report.figures import backend  # noqa: F401  # first: imports Matplotlib
from mast_zenoh.report.html import write_report, write_study_report
from mast_zenoh.report.tables.scores import ScoreTable, as_markdown, as_rich, score_table

__all__ = ["ScoreTable", "as_markdown", "as_rich", "score_table", "write_report", "write_study_report"]
