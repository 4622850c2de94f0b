"""A recorder without I/O: its logs, with their channels, chunks, files, incidents and counters. Pure."""
