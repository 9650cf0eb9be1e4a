"""Runs for other viewers, over a port of this computer, and for ROS 2.

playback       where a finished run is being played
foxglove       WebSocket server of Foxglove and Lichtblick
rerun          recordings for Rerun over HTTP, growing ones of live runs, and its web viewer
other_viewers  serves a run to one of these, and prints its address
ros2           publishes frames on a router of rmw_zenoh
"""
