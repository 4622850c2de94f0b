"""A Zenoh sample to the protobuf bytes of a log. Pure."""
