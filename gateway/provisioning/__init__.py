"""Keys, certificates and grants as files: made where they stay, signed where the authority is, read at a start."""
