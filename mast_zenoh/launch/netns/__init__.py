"""The hosts of a run as linked network namespaces of this machine.

hosts        sets up the namespaces, plays faults, and removes everything
namespaces   network namespaces; removes namespaces of killed launchers; a link as nftables rules and queueing
             disciplines, and which of them this machine supports
relay        a process between two TUN devices that delays packets
router       the process of the router at the centre
"""
