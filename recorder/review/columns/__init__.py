"""Messages of a log as Arrow columns, without a loop over messages.

- ``shape``     what a class of messages holds: its fields, and the Arrow type of each
- ``tables``    the columns of a topic: times, sequence, fields
- ``decoder``   many messages at once to columns, by ptars
- ``reader``    the record batches of a log
"""
