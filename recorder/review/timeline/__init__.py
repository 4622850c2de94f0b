"""The entries of ``events``: how what a log holds becomes a line of what happened."""
