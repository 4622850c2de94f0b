"""Finished logs and incidents to an object store, from a robot that has better things to do.

- ``manifest``    the object beside each log in the store: what it holds, and that it was verified; pure
- ``finished``    a finished log on the disk, read slowly
- ``store``       the questions to a store, and any that obstore knows
- ``row``         a log's row for the catalog, made by another process
- ``uploader``    one log after the other, incidents first
"""
