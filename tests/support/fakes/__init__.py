"""Stand-ins with knobs for failures, in memory and on Zenoh."""
