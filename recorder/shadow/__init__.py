"""A robot's arbiter with other settings, beside the one that drives: a what-if that is live. Pure."""
