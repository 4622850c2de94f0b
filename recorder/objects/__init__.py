"""Objects of a store (S3, GCS, Azure, a directory, a server of HTTPS) as files that can be sought in.

- ``address``   what is an address, and of which store and object
- ``interface`` what is asked of a store, without the library
- ``store``     the questions to a store, and any that obstore knows
- ``ranged``    an object as a binary stream: by ranges, through a small cache of blocks
"""
