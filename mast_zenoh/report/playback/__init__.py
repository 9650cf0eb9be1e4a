"""The page that plays runs in a browser, for the report and for `mast view`.

boxes, motion         every box once, and its meaning in every estimate of every agent
surroundings          buildings, agents, sensors and the space that they swept
conduct, events       manipulations, states of agents, attacks and faults; what happened, in words
columns, block        the compact data block that the page reads
inline                the page: page/*.js joined, style, security policy
server                serves the page of finished runs
live_block            frames of a running run as blocks;  feed: for all pages that are open
live_server, live_view  the page of a running run, until it has ended
page/                 JavaScript modules without a build step
"""
