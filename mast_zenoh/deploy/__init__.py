"""Runs the nodes of a scenario in containers or on other hosts. docs/deploy.md shows how.

engines    the engines by name: compose/, swarm/ and ssh/
wheel      this package and the packages that nodes need, for other hosts;  image: the same as a container image
joining    the launcher's session on a mesh whose router is not its own
doctor     what this machine can do
"""
