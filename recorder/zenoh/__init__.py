"""The recorder's Zenoh sessions: samples in, requests and replies."""
