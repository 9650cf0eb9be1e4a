"""Makes recordings of boxes and paths: what the agents see, and what they detect."""
