"""Results in words, made from the numbers."""
