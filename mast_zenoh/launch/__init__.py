"""Starts, watches and stops the processes of a run.

local        one run and its folder: on a mesh, or in this process
twin         the same run without its adversaries
launching    the run on a mesh, from the first process to the last
supervisor   who starts, watches and ends nodes;  processes: as processes of this machine
steps        what the scenario does to them;  depot: files of nodes elsewhere
latency      what was measured on the wall clock
reports      what its nodes report: failures of handlers, results
conclusion   what is written at the end;  notices: what deserves attention
folder       what the run leaves behind;  nodelogs: logs of nodes in this process
display      what is shown meanwhile
ending       how an ending becomes a status and an exit code;  liveness: whether a launcher lives
interception puts nodes on wires of a run that goes on;  asking: asks for it
engine       where nodes live that are not processes of this machine
measuring    a run measured again, from its recording
network      the hosts of a run as network namespaces
"""
