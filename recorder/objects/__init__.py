"""Objects of a store (S3, GCS, Azure, a directory, an HTTPS server) and local copies of its logs.

- ``address``  addresses of objects, and the interface of a store, without the library
- ``store``    the stores of obstore
- ``cache``    copies of logs on this machine
"""
