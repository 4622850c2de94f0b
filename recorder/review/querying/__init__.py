"""What a statement of SQL may read: the tables of logs, and those of a dataset."""
