"""What a run looked like: its record frame by frame, and files of it for other programs.

frames      the record of a run as arrays, one frame at a time
routes      the estimate that is on each key of a wiring
evaluated   tables of the evaluator by frame: outcomes of objects, scores, changes by interposers
frame_source what other viewers need of a run, finished or live
palette     the colours of objects
formats     the formats of exports, by name
export/     a file per format
loopback    HTTP on the loopback address alone
servers/    runs for Foxglove and Rerun over a local port
"""
