"""The catalog of a directory of logs: one Parquet file beside them, with a row for each log.

- ``log_row``    a row: a summary of a log; also as a separate file, made without pyarrow
- ``directory``  the catalog of a directory or of a place in a store: valid rows, and logs to open
- ``find``       searches in it
"""
