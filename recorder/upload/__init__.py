"""Upload of finished logs and incidents to an object store, at low priority.

- ``finished``  a finished log on the disk, read slowly; its manifest, and its row for the catalog
- ``uploader``  one log after the other, incidents first
"""
