"""Runs for other viewers, over a port of this computer.

foxglove       WebSocket server of Foxglove and Lichtblick, and where a finished run is being played
rerun          recordings for Rerun over HTTP, growing ones of live runs, and its web viewer
other_viewers  serves a run to one of these, and prints its address
"""
