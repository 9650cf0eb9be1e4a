"""Runs a scenario in a Docker swarm, where Docker places the nodes, restarts them and spreads them over machines.

document   the stack file, from what the compose engine writes;  placement: which machine a node may run on
tasks      what Docker says of the nodes;  services: the nodes of a run as services;  logs: what they have said
stack      all that belongs to a run, and its removal;  engine: what `--engine swarm` is
"""
