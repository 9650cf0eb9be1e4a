"""A passive observer of a running run: it receives copies of the messages, and measures the newest whole frames.

address      how a running run is reached: its router, scenario, wiring and scene
reception    the newest messages of each key, in bounded rings; rates, lag and loss on the wires
measurement  a running run, whose frames are measured as the evaluator measures them
observer     all of these for one run: as many frames as cost it nothing, or every one; puts messages together to
             frames, each as soon as it is whole
priority     the right of an observer to the processors
"""
