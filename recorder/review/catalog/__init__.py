"""The catalog of a directory of logs: a summary of each, as a row of one Parquet file beside them.

- ``rows``       a row: what the other questions find in a log
- ``table``      rows as Parquet, and back
- ``directory``  the catalog of a directory: rows that still hold, logs that have to be opened
- ``single``     the row of one log as a file of its own, for an object store; made without pyarrow
- ``place``      the catalog of a place in an object store
- ``known``      a log that need not be opened, for the other questions
"""
