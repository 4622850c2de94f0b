"""Zenoh sessions: publishing, requests and their replies, and the operator's side. It touches the world."""
