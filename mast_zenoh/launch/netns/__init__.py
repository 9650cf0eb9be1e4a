"""The hosts of a run as network namespaces of this machine, and what happens to the links between them.

hosts        from the first namespace to the last: set up, faults in time, torn down
namespaces   namespaces and their links; those that a killed launcher has left
shaping      a link's state as nftables rules and queueing disciplines
machine      what this machine can do
relay        a process between two TUN devices that lets packets wait
router       the process of the router at the centre
"""
