"""A virtual chassis: it behaves as the manual says, with faults on demand."""
