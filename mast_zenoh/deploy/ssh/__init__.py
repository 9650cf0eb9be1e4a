"""Runs on hosts that have an SSH server and a Python, and no Docker.

hostsfile      hosts.toml: the hosts, their addresses, and the placement of nodes
connection     SSH to one host: readable errors, programs, files
installation   installs packages on a host, once per release
onhost         the host's side of it: a program for any Python
warden         the host's supervisor of one run: a process that survives a lost connection
host_processes the processes of the run's nodes on the host
relay          connects standard input and output with the warden's socket
attachment     the launcher's connection to one warden
nodes          the launcher's supervisor of all nodes
startup        starts a run on all hosts
engine         the engine of `--engine ssh`
"""
