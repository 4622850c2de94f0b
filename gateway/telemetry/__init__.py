"""From message to sample: what a frame says, the whole robot in one message, the gateway's health."""
