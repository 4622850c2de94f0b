"""The diagnosis of a robot, with cures: facts in, findings out. Pure; ``gateway/host`` collects the facts."""
