"""``cruiser review``: questions to logs. ``command`` finds the question; each question is a module of its own."""
