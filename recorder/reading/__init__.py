"""A log as topics and messages: what every question of the review reads through."""
