"""The computer of the robot: real-time priority, shared memory, files, and the guard's process."""
