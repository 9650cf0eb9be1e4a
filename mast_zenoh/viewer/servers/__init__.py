"""Serves runs to other viewers, on the loopback address alone.

other_viewers  serves a run to Foxglove, Lichtblick or Rerun, for the command line
playback       where a finished run is being played: pace, pause, seek
foxglove       the WebSocket server of Foxglove and Lichtblick
rerun          recordings for the Rerun viewer over HTTP, and its web viewer
rrd_stream     a live run as a growing recording for the Rerun viewer
web_viewer     the files of Rerun's web viewer
"""
