"""Real processes and sockets, on the loopback alone."""
