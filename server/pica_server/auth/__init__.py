"""Join tokens: who may enter which room."""
