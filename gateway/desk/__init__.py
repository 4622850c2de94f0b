"""The desk: a fleet in a browser. Shows what robots publish, and passes on requests from browsers."""
