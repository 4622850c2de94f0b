"""The directory of logs: the writing thread, files, retention and what a crash left behind."""
