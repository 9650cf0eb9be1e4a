"""The containers of a run on this machine, made by docker-compose (1.29 or 2).

document    the compose file, from a resolved scenario
containers  starts, watches and ends the nodes' containers
engine      the engine: all steps for one run
"""
