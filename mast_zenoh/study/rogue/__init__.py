"""What an outsider tries against a run that is under way, at each level of security, and what comes of it.

attempts     what can be tried: classes that a scenario file names in its `outsider()`
siege        a run that goes on while it is tried
detour       the way of one node to the router, in the outsider's hands
comparison   the same attempts at every level, counted
"""
