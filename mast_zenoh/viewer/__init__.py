"""Shows runs in a browser.

server   one page on a loopback port, for `mast view`

The page itself is `report.playback`, because the report embeds it.
"""
