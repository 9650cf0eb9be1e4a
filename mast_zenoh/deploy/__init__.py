"""Runs a scenario where the nodes live elsewhere: in containers, on other hosts. docs/deploy.md shows how.

engines    finds an engine by its name or its file
compose/   containers of this machine
swarm/     containers of many machines
ssh/       processes on other hosts
wheel      this package and what nodes need, for other hosts
image      the same as a container image
joining    the launcher's session on a mesh whose router is elsewhere
addresses  addresses and ports of this machine
doctor     what this machine can do
"""
