"""Hosts nodes: one host for all of them, and a runtime for each way to run it.

host         one node, without I/O: checks, holds, counts;  held: waiting messages;  limits: their number and size
context      the node's interface to its host: publish, relay, random streams, log;  delayed: delayed messages
inproc       all nodes in one process;  played: nodes that send what was recorded
recorded_results  the results of one node, computed from a recording
mesh/        one node as a process on a Zenoh mesh, and the driver
lockstep/    when the next frame may begin, without I/O
remote_node  a node on a host without the run folder;  file_client: transfers its files
"""
