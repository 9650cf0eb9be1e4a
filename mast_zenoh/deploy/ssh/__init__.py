"""Runs on hosts that have an SSH server and a Python, and no Docker.

hostsfile   hosts.toml: the hosts, their addresses, and the placement of nodes
connection  SSH to one host: readable errors, programs, files, and installing packages; the launcher's connections to
            wardens
onhost      the host's side of the installation: a program for any Python
warden      the host's supervisor of one run: a process that survives a lost connection
engine      the engine of `--engine ssh`: startup, and the nodes as the launcher sees them
"""
