"""A log played again, over Zenoh or onto a CAN bus."""
