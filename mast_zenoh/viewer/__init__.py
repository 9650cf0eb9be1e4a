"""What a run looked like: its record frame by frame, and files of it for other programs.

frame       one frame of a run as arrays, and what viewers need of a run, finished or running
frames      the record of a finished run, one frame at a time
routes      the estimate that is on each key of a wiring
evaluated   tables of the evaluator by frame: outcomes of objects, scores, changes by interposers
palette     the colours of objects
formats     the formats of exports, by name
export/     a file per format
loopback    HTTP on the loopback address alone
servers/    runs for Foxglove and Rerun over a local port
live/       a passive observer of a running run

The page that shows runs in a browser, finished or running, is in report/playback.
"""
