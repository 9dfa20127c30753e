"""A call on this machine: relay and senders as processes of their own, for demo and bench."""
