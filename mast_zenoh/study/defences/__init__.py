"""Studies of defences against adversaries.

    kinds          the kinds of studies, each with a folder:
                   matrix (every defence against every adversary), drift (how soon a displaced object is noticed),
                   breakdown (with how many liars a defence breaks)

    choices        names, files or dicts of defences and adversaries
    fault_presets  faults that a defence may mistake for lies
    placement      numbers of agents, and which of them are compromised
    bound          where honest viewers outnumber malicious ones
    survival       times until detection, with censored ones
    intervals      95 % intervals over trials
    study_files    the files that a study writes

See docs/defence_studies.md.
"""

from mast_zenoh.study.defences.breakdown.cell import BreakdownCell
from mast_zenoh.study.defences.choices import (
    COORDINATED,
    UNCOORDINATED,
    adversary_base,
    has_budget,
    junctions,
    parse_choices,
    resolve_choice,
    several,
    short_name,
    with_preset,
    words,
)
from mast_zenoh.study.defences.drift.cell import DriftCell
from mast_zenoh.study.defences.fault_presets import faults_of
from mast_zenoh.study.defences.matrix.cells import Cell, matrix_study
from mast_zenoh.study.defences.placement import PLACEMENTS, place, sensors_of

__all__ = [
    "COORDINATED",
    "PLACEMENTS",
    "UNCOORDINATED",
    "BreakdownCell",
    "Cell",
    "DriftCell",
    "adversary_base",
    "faults_of",
    "has_budget",
    "junctions",
    "matrix_study",
    "parse_choices",
    "place",
    "resolve_choice",
    "sensors_of",
    "several",
    "short_name",
    "with_preset",
    "words",
]
