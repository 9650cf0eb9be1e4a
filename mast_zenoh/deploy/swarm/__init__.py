"""Runs a scenario in a Docker swarm: Docker places and restarts the nodes.

document   the stack file, made from the compose file;  placement: the machines on which a node may run
tasks      the state of nodes' tasks;  services: the nodes of a run as services;  logs: their output
stack      lists and removes what belongs to a run;  engine: the engine of `--engine swarm`
"""
