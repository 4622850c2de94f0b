"""The links of ``why``: how what a log holds becomes a chain from frames and requests to a decision."""
