"""What is wrong with a robot, and its cure: facts in, findings out. Pure; ``gateway/host`` looks the facts up."""
