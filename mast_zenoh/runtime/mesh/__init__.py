"""Runs the protocols of nodes as processes on a Zenoh mesh.

zenoh_process   carries out the actions of a protocol, and brings it what arrives: the only part with threads
hosting         builds a node's process from a resolved scenario, and ends it with the launcher
session         Zenoh sessions with our settings

Control messages are below mast/{run}/@control/, a verbatim chunk, which no wildcard matches: see mast_zenoh.control.
"""
