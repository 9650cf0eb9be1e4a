"""Runs on hosts that have an SSH server and a Python, and no Docker.

hostsfile      which hosts, how to reach them, who goes where
connection     SSH to one host: errors in words, programs, files
installation   what nodes need, brought to a host once per release
onhost         the same from the host's side; a program that any Python runs
warden         the host's supervisor of one run: a process that outlives a lost connection
host_processes the processes of the run's nodes there
attachment     the launcher's end of one warden
nodes          the launcher's supervisor over all of them
engine         brings it all up, and takes it away
"""
