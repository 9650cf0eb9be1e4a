"""Runs a scenario where the nodes live elsewhere: in containers, on other hosts. docs/deploy.md shows how.

engines    which there are;  compose: containers of this machine
commands   `mast deploy …` and `mast doctor`
wheel      this package and what nodes need, for other hosts;  image: the same as a container image
joining    the launcher's session on a mesh whose router is elsewhere
doctor     what this machine can do
"""
