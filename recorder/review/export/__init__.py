"""Logs in other forms, for tools that do not know MCAP.

- ``manifest``     what a dataset holds, and what it was made of
- ``parts``        the Parquet files of one log, written while it is read, in bounded memory
- ``one_log``      one log into a dataset: a function of its own, which may run anywhere
- ``dataset``      many logs into a dataset
- ``cells``        Arrow columns as text and as JSON
- ``csv_files``    one CSV file a topic
- ``raw_frames``   raw frames in the order of time, for the tools of CAN
"""
