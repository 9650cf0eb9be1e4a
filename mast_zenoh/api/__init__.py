"""Runs as Python objects for notebooks and scripts: `import mast_zenoh as mast`.

See docs/how-to-python.md.

    runs         that object: the model of `runs`, with plots, report, exports and films; run: a scenario in, a run
                 out; open: a run folder in, the same object out
    scenes       scene: truth, poses and detections of a scene, without a run
    catalogue    list: what a scenario can name, with its parameters: defaults, units, meanings

`mast.compare` is in mast_zenoh.show.compare, `mast.study` in mast_zenoh.study.interface.
"""
