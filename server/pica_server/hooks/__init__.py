"""Room events, told to somebody else's server by webhooks."""
