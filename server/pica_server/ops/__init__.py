"""How a relay is watched: log, metrics, status pages, event loop, certificate."""
