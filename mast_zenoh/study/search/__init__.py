"""Searches for the attack parameters that harm most: attackers that optimise.

    space      parameters with ranges, written as `0.5..4.0`, `1..3` or a list of choices
    objective  the number that a search maximises or minimises, of one trial
    plan       the section `search` of a study file
    proposals  Optuna proposes candidates in batches, from the values of those before
    searching  carries out a search, then measures its result on seeds that it has not seen

See docs/search.md.
"""
