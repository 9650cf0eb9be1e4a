"""A passive observer of a running run: it receives copies of the messages, and measures the newest whole frames.

observed     what an observer must know of a run: scenario, wiring, scene
reception    the newest messages of each key, in bounded rings
measurement  one frame, measured as the evaluator measures it
wires        rates, lag and loss on the wires
observer     all of these for one run
source       the frames of such a run, for servers to other viewers
"""
