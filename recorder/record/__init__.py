"""What a recorder writes, without I/O: the recording, its logs, channels, incidents and counters. Pure."""
