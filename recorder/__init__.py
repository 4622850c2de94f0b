"""Records Zenoh samples as MCAP, and reads the logs."""
