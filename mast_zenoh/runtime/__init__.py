"""Hosts nodes. The host is the same everywhere; a runtime is a shell around it.

host         one node, without I/O: checks, holds back, counts;  held: messages that wait;  limits: how much may
context      what a node sees of it: publish, relay, random streams, log;  delayed: messages that leave later
inproc       all nodes in one process;  replaying: one node, from a recording
mesh/        one node as a process on a Zenoh mesh, and the driver
lockstep/    when the next frame may begin, without I/O
remote_node  a node where the run folder is not;  file_client: its files
"""
