"""Defences against adversaries: a matrix of runs, and what each defence is worth.

    choices     names, files or dicts of defences and adversaries
    natural     faults that a defence may mistake for lies
    placement   which agents are compromised
    cells       the cells of the matrix as configurations of a study
    bound       where honest viewers outnumber malicious ones
    lies        the lies of one run, and which of them were detected
    traces      the trust of one run over time
    records     what the matrix needs of one trial
    survival    times until detection, with censored ones
    intervals   95 % intervals over trials
    pooled      numbers over the trials of a cell or of a defence
    estimates   the matrix: a row for each cell, a summary for each defence
    outputs     tables and figures

Limits of a defence, which have studies of their own:

    limits      the configurations of both
    floor       the least delay with which a displaced object can be noticed
    episodes    how long displaced objects were in view before their liar was suspended
    drift       delays next to the floor; drift_trial: of one run
    breakdown   with how many liars a defence breaks; breakdown_trial: in one run
    crossing    the share of liars at which a curve reaches one half

    evaluations   what is evaluated in each trial of any of these studies
    measurements  what is collected from all trials, and written

See docs/studies.md.
"""

from mast_zenoh.study.defences.bound import expected_honest_majority, honest_majority
from mast_zenoh.study.defences.cells import Cell, matrix
from mast_zenoh.study.defences.choices import adversary_base, named, parsed
from mast_zenoh.study.defences.placement import PLACEMENTS, by_coverage, place
from mast_zenoh.study.defences.survival import Survival, kaplan_meier

__all__ = [
    "PLACEMENTS",
    "Cell",
    "Survival",
    "adversary_base",
    "by_coverage",
    "expected_honest_majority",
    "honest_majority",
    "kaplan_meier",
    "matrix",
    "named",
    "parsed",
    "place",
]
