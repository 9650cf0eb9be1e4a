"""Reader of traces of the traffic simulator SUMO."""
