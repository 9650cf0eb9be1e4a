"""Hosts nodes: one host for all of them, and a runtime for each way to run it.

host         one node, without I/O: checks, holds, counts, numbers and delays its messages
waiting      items that wait until they are due, and limits on the number and size of waiting messages
inproc       all nodes in one process
player       nodes that send what was recorded
protocol/    what the processes of a run do, as state machines without I/O
protocol_log what such a state machine was given and has asked for, and its replay
mesh/        one node as a process on a Zenoh mesh
strays       ends what the code of a node has started, and would outlive it
file_client  transfers the files of a node on a host without the run folder
"""
