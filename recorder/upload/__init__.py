"""Finished logs and incidents to an object store, from a robot that has better things to do.

- ``finished``  a finished log on the disk, read slowly; its manifest, and its row for the catalog
- ``uploader``  one log after the other, incidents first
"""
