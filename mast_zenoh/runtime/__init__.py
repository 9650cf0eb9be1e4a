"""Hosts nodes. The host is the same everywhere; a runtime is a shell around it.

host      one node: checks, holds back, counts; no I/O
inproc    all nodes in one process
mesh      one node as a process on a Zenoh mesh
driver    the mesh process that decides when the next frame begins
pacer     when that may be, without I/O
timetable what is done to processes before which frame, without I/O
delayed   messages that leave later
process   the `main` of every node's file
session   Zenoh sessions as we open them
results   what nodes hand in at the end
failures  failures of handlers: counted, merged, in words
"""
