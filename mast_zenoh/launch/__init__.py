"""Starts, watches and stops the processes of a run.

local        one run on this machine, from the first process to the last
supervisor   who starts, watches and ends nodes;  processes: as processes of this machine
steps        what the scenario does to them
latency      what was measured on the wall clock
folder       what the run leaves behind
display      what is shown meanwhile
network      the hosts of a run as network namespaces
"""
