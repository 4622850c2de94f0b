"""The only importers of python-can and Zenoh in this package."""
