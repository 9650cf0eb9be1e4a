"""A run, finished or going on: its tables and its frames. Whatever shows runs reads it.

run          the model: what its documents and tables say
files        the documents and tables in its folder, each read when it is asked for
frame        one frame of a run, and its objects, outcomes, scores and manipulations
evaluated    what the evaluator says about frames: outcomes, scores, changes
recorded     the frames of a finished run, from its recording
messages     recorded messages, decoded, and their states of objects as tables
scans        recorded scans of lidars by frame, as their detectors received them
spoofers     where the spoofers of lidars are, as their effects tell
observability  which lies of a run an honest agent could have noticed
live/        a passive observer of a running run, whose frames are the same
routes       the estimate that is on each key of a wiring
interposers  the nodes on the wires of a run, and what they changed
driven       what driven cars did, why they braked, and what they did in the unattacked twin
events       what happens in a run, over time and in words
"""
