"""The MCAP file format both ways: records and messages, whole or damaged. It opens no file."""
