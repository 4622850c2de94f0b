"""Tables that a statement of SQL may read: those of logs, and those of a dataset."""
