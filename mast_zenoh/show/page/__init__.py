"""The page that plays runs in a browser, for the report and for `mast view`.

block        frames of a run as a compact block of columns, which the page reads
motion       the boxes of a page and their motion; packs columns of integers
page         the page: js/*.js joined, style, security policy
live_server  serves the page of finished runs, and a running run: its frames as blocks, until it has ended
js/          JavaScript modules without a build step
"""
