"""The containers of a run on this machine, made by docker-compose (1.29 or 2).

document    the compose file, from a resolved scenario
containers  who starts, watches and ends them
engine      all of it for one run
"""
