"""The containers of a run on this machine, made by docker-compose (1.29 or 2).

document    the compose file, from a resolved scenario
containers  starts, watches and ends the nodes' containers
engine      the engine: all steps for one run
inside      the launcher as a service of the file, with started_nodes, which Compose has started
certificates    the service that makes the credentials of all others
examples    the files in deploy/compose/
"""
