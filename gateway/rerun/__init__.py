"""A recorded journal once more through the core: with the same settings, or with others. Pure."""
