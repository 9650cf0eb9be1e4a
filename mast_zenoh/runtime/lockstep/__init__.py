"""State machines, without I/O: when a frame may begin, and what precedes it."""
