"""Runs as Python objects for notebooks and scripts: `import mast_zenoh as mast`.

See docs/python.md.

    execution    run: a scenario in, a run out; open: a run folder in, the same object out
    runs         the object: tables, messages, agents, plots, report
    messages     recorded messages, decoded; states of objects by frame, as tables
    scenes       scene: truth, poses and detections of a scene, without a run
    plots        the report's figures of a run, or of several
    comparisons  compare: the same scores of several runs, and what differs in words
    catalogue    list: what a scenario can name, with its parameters: defaults, units, meanings
    surface      the base classes that users derive from

`mast.study` is in mast_zenoh.study.interface.
"""
