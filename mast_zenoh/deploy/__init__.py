"""Runs a scenario with nodes in containers or on other hosts; see docs/how-to-hosts.md.

engine     what all deployments share: startup, supervision, logs, removal
engines    finds an engine by its name or its file
documents  a resolved scenario as a compose file
docker     the `docker` command, and the image of the nodes
compose    containers of this machine;  compose_inside: a compose file that plays a run by itself
ssh/       processes on other hosts
wheel      this package and what nodes need, for other hosts
remote_node  the process of a node on a host without the run folder
doctor     checks of this machine's capabilities
"""
