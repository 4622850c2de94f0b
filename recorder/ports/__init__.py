"""The only importers of Zenoh in this package."""
