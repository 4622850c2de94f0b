"""The catalog of a directory of logs: a summary of each, as a row of one Parquet file beside them.

- ``log_row``    a row: what the other questions find in a log; as a file of its own too, made without pyarrow
- ``directory``  the catalog of a directory or of a place in a store: rows that still hold, logs to be opened
- ``find``       searches in it
"""
