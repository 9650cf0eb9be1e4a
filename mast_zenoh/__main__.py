"""`python -m mast_zenoh` is `mast`."""

from mast_zenoh.cli import main

main()
