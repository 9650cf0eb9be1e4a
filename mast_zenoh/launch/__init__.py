"""Starts, watches and stops the processes of a run.

local        one run on this machine, from the first process to the last
supervisor   the processes
folder       what the run leaves behind
display      what is shown meanwhile
"""
