"""One model of a run, finished or running: its tables and its frames; its page, and files of it for other programs.

run          the record of a run as tables
frame        one frame of a run, and its objects, outcomes, scores and manipulations
recorded     a finished run with its recording, one frame at a time
live/        a passive observer of a running run, whose frames are the same
routes       the estimate that is on each key of a wiring
interposers  the nodes on the wires of a run, and what they changed
driven       what driven cars did, why they braked, and what they did in the unattacked twin
events       what happens in a run, over time and in words
palette      all colours
page/        the page that plays runs in a browser
formats      the formats of exports, by name
export/      a file per format
loopback     HTTP on the loopback address alone
ros2_bridge  publishes frames on a router of rmw_zenoh
"""
