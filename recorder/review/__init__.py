"""Turns a log into answers.

- ``walk``   the records of an MCAP file one by one, damaged or cut off as it may be
- ``alive``  frames lost on the bus, by their alive counters
- ``info``   what a log holds, and what it lacks
"""
