"""When the next frame may begin, and what happens to processes before it. State machines without I/O."""
