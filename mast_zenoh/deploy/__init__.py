"""Runs a scenario with nodes in containers or on other hosts; see docs/deploy.md.

engines    finds an engine by its name or its file
compose/   containers of this machine
swarm/     containers of many machines
ssh/       processes on other hosts
wheel      this package and what nodes need, for other hosts
image      the same as a container image
remote_node  the process of a node on a host without the run folder
joining    the launcher's session on a mesh whose router is not its own
addresses  addresses and ports of this machine
doctor     checks of this machine's capabilities
"""
