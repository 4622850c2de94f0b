"""A log published again over Zenoh."""
