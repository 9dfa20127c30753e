"""The avatar store of a relay: files by the SHA-256 of their bytes."""
