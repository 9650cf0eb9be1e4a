"""Prints whether compiled kernels are in use: `python -m mast_zenoh.kernels`."""

from mast_zenoh import kernels

print(kernels.notice() or "kernels are compiled")
