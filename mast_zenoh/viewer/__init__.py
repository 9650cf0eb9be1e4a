"""What a run looked like: its record frame by frame, and files of it for other programs.

frames      the record of a run as arrays, one frame at a time
routes      the estimate that is on each key of a wiring
evaluated   tables of the evaluator by frame: outcomes of objects, scores, changes by interposers
palette     the colours of objects
export/     a file per format
"""
