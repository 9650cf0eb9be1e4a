"""Studies of defences against adversaries.

    kinds      what all kinds of studies have; each kind is a module:
               matrix (every defence against every adversary), drift (how soon a displaced object is noticed),
               breakdown (with how many liars a defence breaks), field_matrix (the matrix of published and own methods),
               cooperation (how far a lie reaches, by where tracks are fused), driving_matrix (what attacks do to a
               driven car, with each defence)
    published  what papers report of these methods
    matrix_trial    what the matrix needs of one trial
    choices    names, files or dicts of defences, adversaries and faults, which agents are compromised, and their runs
    intervals  95 % intervals over trials, and times until detection

See docs/defence_studies.md.
"""

from mast_zenoh.study.defences.choices import (
    COORDINATED,
    PLACEMENTS,
    UNCOORDINATED,
    adversary_base,
    faults_of,
    has_budget,
    junctions,
    matrix_study,
    measured_by,
    parse_choices,
    place,
    resolve_choice,
    scenes_of_kinds,
    sensors_of,
    several,
    short_name,
    with_preset,
    words,
)

__all__ = [
    "COORDINATED",
    "PLACEMENTS",
    "UNCOORDINATED",
    "adversary_base",
    "faults_of",
    "has_budget",
    "junctions",
    "matrix_study",
    "measured_by",
    "parse_choices",
    "place",
    "resolve_choice",
    "scenes_of_kinds",
    "sensors_of",
    "several",
    "short_name",
    "with_preset",
    "words",
]
