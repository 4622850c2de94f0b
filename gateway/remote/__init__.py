"""The other end: what a person at a terminal sees of the robots."""
