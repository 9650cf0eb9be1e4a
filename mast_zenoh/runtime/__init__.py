"""Hosts nodes. The host is the same everywhere; a runtime is a shell around it.

host           one node: checks, holds back, counts; no I/O
context        what a node sees of it: publish, relay, random streams, log
delayed        messages that leave later;  limits: how much may wait
inproc         all nodes in one process;  replaying: one node, from a recording
mesh           one node as a process on a Zenoh mesh;  inbox: what waits for its main thread;  stamp: of its messages
driver         the mesh process that decides when the next frame begins;  pacer: when that may be, without I/O
rewiring       how the wiring changes while a run goes on
timetable      what is done to processes before which frame, without I/O
session        Zenoh sessions as we open them
hosting        from a resolved scenario to a node's process;  process: its `main`
elsewhere      the same where the run folder is not;  file_client: its files;  launcher_watch: is the launcher there
results        what nodes hand in at the end;  failures: of handlers, counted, merged, in words
"""
