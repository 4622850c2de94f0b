"""What touches the world: Zenoh, and the directory of logs. The only importers of Zenoh in this package."""
