"""The page that plays runs in a browser, for the report and for `mast view`.

block        frames of a run as a compact block of columns, which the page reads;  motion: of its boxes
columns      packs columns of integers
page         the page: js/*.js joined, style, security policy; serves the page of finished runs
live_view    a running run: its frames as blocks, until it has ended
live_server  serves these to all pages that are open
js/          JavaScript modules without a build step
"""
