"""Objects of a store (S3, GCS, Azure, a directory, a server of HTTPS) and copies of logs of it.

- ``address``  what is an address, of which store and object, and what is asked of a store, without the library
- ``store``    the questions to a store, and any that obstore knows
- ``cache``    copies of logs on this machine
"""
