"""The desk: a fleet in a browser. It shows what robots say, and carries what browsers ask to them."""
