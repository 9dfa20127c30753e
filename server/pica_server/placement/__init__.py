"""Which relay has which room: a bucket of NATS maps rooms to relays."""
