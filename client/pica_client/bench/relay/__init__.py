"""Load for a relay: rooms of simulated peers in processes of their own, and what they cost."""
